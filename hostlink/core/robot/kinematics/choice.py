"""The drive of a robot by its settings. Pure."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from hostlink.core.robot.kinematics.ackermann import AckermannDrive
from hostlink.core.robot.kinematics.drive import WHERE, Drive, PlanarDrive
from hostlink.core.robot.kinematics.wheeled import (
    DifferentialDrive,
    MecanumDrive,
    Omni4Drive,
    OmniDrive,
    SkidSteerDrive,
)
from hostlink.errors import ConfigError

DRIVES: dict[str, type[Drive]] = {
    "": PlanarDrive,
    "planar": PlanarDrive,
    "spatial": PlanarDrive,  # of its topics none belongs to a robot
    "differential": DifferentialDrive,
    "skid_steer": SkidSteerDrive,
    "mecanum": MecanumDrive,
    "omni3": OmniDrive,
    "omni4": Omni4Drive,
    "ackermann": AckermannDrive,
}
SETTINGS = (  # dimensions of a drive; None: not configured
    "wheel_separation_m",
    "separation_factor",
    "wheelbase_m",
    "max_steering_rad",
    "wheel_distance_m",
    "wheel_angles_deg",
)

WHEELS_NEED = {  # dimensions without which the speeds of a drive's wheels are not known
    "differential": ("wheel_separation_m",),
    "skid_steer": ("wheel_separation_m",),
    "mecanum": ("wheel_separation_m", "wheelbase_m"),
    "omni3": ("wheel_distance_m",),
    "omni4": ("wheel_distance_m",),
    "ackermann": ("wheel_separation_m",),
}


def drive_of(kinematics: str, dimensions: Mapping[str, Any]) -> Drive:
    """Return the drive of `kinematics` with the dimensions of SETTINGS that are not None.

    Raises:
        ConfigError: a dimension is invalid, or is not one of this drive.
    """
    drive = DRIVES[kinematics]
    own = [each.name for each in dataclasses.fields(drive) if each.init]
    given = {name: value for name, value in dimensions.items() if value is not None}
    for name in given:
        if name not in own:
            known = ", ".join(each for each in SETTINGS if each in own)
            raise ConfigError(WHERE, f'{name} is not a setting of kinematics = "{kinematics}", which takes {known}')
    made: Drive = drive(**{"wheel_separation_m": 0.0, **given} if "wheel_separation_m" in own else given)
    return made
