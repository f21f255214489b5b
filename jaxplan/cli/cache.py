"""``jaxplan cache``: what was compiled and is kept for the next start."""

import sys
from typing import Literal


def cache(action: Literal["on", "off", "clear", "status"] = "status", *, debug: bool = False) -> int:
    """What is compiled is kept, so that later starts load it.

    Parameters
    ----------
    action
        off: keep it no longer; on: from now on; clear: remove what is kept; status: say what is.
    debug
        Show the traceback of an error.
    """
    from jaxplan import programs

    if action in ("on", "off"):
        programs.switch(action == "on")
    elif action == "clear":
        programs.clear()
    found = programs.status()
    kept = f"{found.programs} programs, {found.size / 1e6:.1f} MB, in {found.folder}"
    print(f"{'on' if found.on else 'off'}: {kept}")
    if found.others:
        print(f"{found.others} folders of other machines or versions, which are not used: jaxplan cache clear")
    return 0


def use_cache() -> None:
    """Use the programs that are kept, unless a user does not want that; says what is wrong with them, if anything."""
    from jaxplan import programs

    complaint = programs.use()
    if complaint is not None:
        print(f"jaxplan: {complaint}", file=sys.stderr)
