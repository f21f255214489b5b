"""``jaxplan world``: what a map holds."""

import os
from pathlib import Path


def world(file: str, *, padding: float = 0.5, out: str = "world.png", debug: bool = False) -> int:
    """Read a map, say what was read, and draw it.

    Parameters
    ----------
    file
        A stored world's name (env1, env2, env3) or a file: .xml .stl .obj .ply .pcd .npy .npz .bt .json.
    padding
        Distance [m] that paths keep from obstacles.
    out
        Where the picture is saved.
    debug
        Show the traceback of an error.
    """
    from jaxplan.errors import InputError
    from jaxplan.names import require_world

    if not os.path.isdir(Path(out).parent) or Path(out).suffix != ".png":
        raise InputError(f"--out: have {out!r}, want a .png file in a folder that exists; correct it")
    require_world(file)
    import numpy as np

    from jaxplan.io.targets import load_target, stored_targets
    from jaxplan.viz.world import draw_world_picture
    from jaxplan.world.load import load_world
    from jaxplan.world.occupancy import RESOLUTIONS, fitting_resolution
    from jaxplan.world.report import lattice_reports, obstacle_counts

    read = load_world(file)
    size = " x ".join(f"{side:.4g}" for side in read.bounds[1] - read.bounds[0])
    print(f"{read.provenance}\nextent    {size} m, from {read.bounds[0].tolist()} to {read.bounds[1].tolist()}")
    print("obstacles " + (", ".join(f"{count} {kind}" for kind, count in obstacle_counts(read).items()) or "none"))
    print(f"{'lattice':>9} {'cells':>10} {'occupied':>9} {'largest free part':>18} {'parts':>6}")
    finest = fitting_resolution(read)
    for row in lattice_reports(read, tuple(finest * ratio for ratio in (1, 2, 5, 10)), padding):
        largest = f"{row.largest:.1%}" if row.parts else "-"
        print(f"{row.resolution:>7g} m {row.cells:>10} {row.occupied:>9.1%} {largest:>18} {row.parts:>6}")
    if finest > RESOLUTIONS[0]:
        print(f"too large for cells of {RESOLUTIONS[0]:g} m: jaxplan intercept --resolution {finest:g}")
    targets = [load_target(name, world=file) for name in stored_targets(file)]
    curves = {target.name: target.position(np.linspace(0.0, target.duration, 400)) for target in targets}
    draw_world_picture(read, Path(out), curves, padding, finest)
    print(f"picture   {out}")
    return 0
