"""Worlds as keys of caches: their arrays have no hash, but their names tell them apart."""

import dataclasses

from jaxplan.world.obstacles import World


@dataclasses.dataclass(frozen=True)
class NamedWorld:
    """A world that equals every other one of its name."""

    name: str
    world: World = dataclasses.field(compare=False)


def named(world: World) -> NamedWorld:
    """The world as a key."""
    return NamedWorld(world.name, world)
