"""``jaxplan vehicle``: what a vehicle is, and whether its gains hold it."""

from jaxplan.cli.cache import use_cache


def vehicle(name: str | None = None, *, trial: bool = True, debug: bool = False) -> int:
    """Read a vehicle, say what it can do and what was assumed, and fly it a little.

    Parameters
    ----------
    name
        A preset or a file: TOML of the presets' form, or MJCF (.xml). Without one the presets are listed.
    trial
        Fly a hover, an eight and a turn.
    debug
        Show the traceback of an error.
    """
    from pathlib import Path

    from jaxplan.names import list_presets, require_vehicle

    if name is None:
        print("\n".join(list_presets()))
        return 0
    require_vehicle(name)
    use_cache()
    from jaxplan.vehicle.load import load_vehicle
    from jaxplan.vehicle.report import vehicle_lines, vehicle_warnings
    from jaxplan.vehicle.toml import read_vehicle

    found = load_vehicle(name)
    assumed = read_vehicle(Path(name)).assumed if Path(name).suffix.lower() == ".toml" else {}
    lines = vehicle_lines(found)
    width = max(len(line.name) for line in lines)
    print("\n".join(f"{line.name:<{width}}  {line.value} {line.unit}".rstrip() for line in lines))
    for key, rule in assumed.items():
        print(f"assumed: {key} ({rule})")
    for warning in vehicle_warnings(found):
        print(f"warning: {warning}")
    if trial:
        from jaxplan.tracking.trial import trial_flights

        for flight in trial_flights(found):
            said = "held" if flight.held else "NOT held"
            print(
                f"{flight.name:<6} {said}: error {flight.error:.3f} m (want < {flight.limit:.2f}), "
                f"rotors at a limit {100.0 * flight.saturated:.0f} % of the time"
            )
    return 0
