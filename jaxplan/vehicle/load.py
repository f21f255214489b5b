"""Vehicles by name or from any file: the one way in."""

from pathlib import Path

from jaxplan.validation import require_path
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.toml import preset, vehicle_from_toml


def load_vehicle(name_or_path: str | Path = "mfrl") -> Vehicle:
    """A preset by name ("mfrl", "flightgoggles"), or by path a TOML file of the presets' form or an MJCF file (.xml).

    What has a suffix or a folder is a path. Raises InputError for an unknown name, FileError for a file that cannot be
    used. ``jaxplan.vehicle.mjcf.vehicle_from_mjcf`` says what is read from MJCF.
    """
    require_path("vehicle", name_or_path)
    path = Path(name_or_path)
    if path.suffix.lower() == ".xml":
        from jaxplan.vehicle.mjcf import vehicle_from_mjcf  # MuJoCo, only where it is needed

        return vehicle_from_mjcf(path)
    if path.suffix or path.parent != Path("."):
        return vehicle_from_toml(path)
    return preset(str(name_or_path))
