"""Tuning: motors that are identified from a record, the gains that follow beside the present ones, and sending them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from hostlink.cli.output import table
from hostlink.cli.step_recorder import GAINS_TYPE, RobotTopics, wheel_parameter
from hostlink.cli.step_report import rounded, sample_view
from hostlink.client import Host
from hostlink.errors import HostlinkError
from hostlink.robot.motor_model import MotorModel, PidGains, identify_motor, simc_gains
from hostlink.robot.step_response import Record

PAPER_GAINS = {"left": PidGains(23.0, 36.0, 0.1), "right": PidGains(24.0, 35.0, 0.1)}  # docs/robot.md#numbers
GAINS = 3
RULE = "SIMC: S. Skogestad, J. Process Control 13 (2003) 291-309, tau_c = dead time"


@dataclass(frozen=True, slots=True)
class TunedWheel:
    """One motor and its gains."""

    model: MotorModel
    present: PidGains
    is_configured: bool  # present are the ones of the configuration, else those of the firmware
    proposed: PidGains


@dataclass(frozen=True, slots=True)
class Tuning:
    """What tuning a robot gave."""

    robot: str
    wheels: Mapping[str, TunedWheel]
    is_sent: bool

    def lines(self) -> list[str]:
        """For people."""
        rows = [
            row
            for side, wheel in self.wheels.items()
            for row in (
                [side, "present", *_digits(wheel.present), _origin(wheel)],
                ["", "proposed", *_digits(wheel.proposed), ""],
            )
        ]
        settings = [
            f'  "/{self.robot}/gains_{side}" = {[float(word) for word in _digits(wheel.proposed)]}'
            for side, wheel in self.wheels.items()
        ]
        return [
            *(f"{side} motor: {wheel.model}" for side, wheel in self.wheels.items()),
            *table(["", "", "Kp", "Ki", "Kd", ""], rows),
            f"rule: {RULE}",
            "",
            "sent to the robot, until it is switched off" if self.is_sent else "not sent; --send sends them",
            "for good, under [parameters] of the daemon's configuration:",
            *settings,
        ]

    def view(self, records: Mapping[str, Record]) -> dict[str, Any]:
        """For programs."""
        return {
            "rule": RULE,
            "is_sent": self.is_sent,
            "wheels": {
                side: {
                    "model": rounded(asdict(wheel.model)),
                    "present": asdict(wheel.present) | {"is_configured": wheel.is_configured},
                    "proposed": rounded(asdict(wheel.proposed)),
                    "samples": sample_view(records[side]),
                }
                for side, wheel in self.wheels.items()
            },
        }


async def tune(host: Host, robot: str, records: Mapping[str, Record], *, sends: bool) -> Tuning:
    """Identify each motor, and send the gains where that is requested.

    Raises:
        HostlinkError: a motor was not identified; the robot accepts no gains; there is no connection.
    """
    wheels = {}
    for side, record in records.items():
        model = identify_motor(record)
        configured = await wheel_parameter(host, robot, f"gains_{side}")
        is_configured = len(configured) == GAINS
        present = PidGains(*configured) if is_configured else PAPER_GAINS[side]
        wheels[side] = TunedWheel(model, present, is_configured, simc_gains(model))
    if sends:
        await _send(host, robot, wheels)
    return Tuning(robot, wheels, sends)


async def _send(host: Host, robot: str, wheels: Mapping[str, TunedWheel]) -> None:
    topics = RobotTopics(await host.robot(robot).state(), await host.links())
    found = {side: topics.find(f"pid_tune_{side[0]}", GAINS_TYPE) for side in wheels}
    for side, topic in found.items():
        if topic is None:
            raise HostlinkError(f"{robot} accepts no gains: it subscribes to no pid_tune_{side[0]} of {GAINS_TYPE}")
    for side, topic in found.items():
        gains = wheels[side].proposed
        await host.publish(str(topic), {"x": gains.kp, "y": gains.ki, "z": gains.kd}, type_name=GAINS_TYPE)
    await host.settle()


def _digits(gains: PidGains) -> list[str]:
    return [f"{gains.kp:.1f}", f"{gains.ki:.1f}", f"{gains.kd:.1f}"]


def _origin(wheel: TunedWheel) -> str:
    return "of the configuration" if wheel.is_configured else "of the firmware (the paper's table 1)"
