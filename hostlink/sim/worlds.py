"""Which world a simulated robot has: the C++ one where its library is built, else its Python twin."""

from hostlink.sim.drive_train import DriveTrain
from hostlink.sim.world import World
from hostlink.sim.world_library import NativeWheel, NativeWorld, WorldLibraryMissing
from hostlink.sim.world_parameters import WorldParameters

AnyWorld = World | NativeWorld
AnyWheel = DriveTrain | NativeWheel


def open_world(parameters: WorldParameters | None = None) -> AnyWorld:
    """A new world; both kinds compute the same digits."""
    try:
        return NativeWorld(parameters)
    except WorldLibraryMissing:
        return World(parameters)
