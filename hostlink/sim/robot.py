"""SimulatedRobot: the paper's robot on a SimulatedDevice: topics, 30 Hz loop, watchdog, odometry. Pure."""

import math
from functools import partial
from typing import Any

from hostlink.messages.catalog import Catalog
from hostlink.messages.message_type import MessageType
from hostlink.protocol.control import Parameter
from hostlink.robot.kinematics import Pose
from hostlink.sim.controller import LOOP_S, PAPER, Gains, Temper, WheelController, WheelFault
from hostlink.sim.device import SimulatedDevice
from hostlink.sim.geometry import PARAMETERS, Geometry
from hostlink.sim.self_report import Battery, Error, Errors
from hostlink.sim.worlds import AnyWheel, AnyWorld, open_world

PUBLISH_EVERY = 3
REPORT_EVERY = 10  # of what it publishes: once a second
WATCHDOG_S = 0.5
_EDGES = 1 << 32  # a board's counter wraps
_INFO = 1
_WARN = 2
_ERROR = 3
_TYPES = (
    "geometry_msgs/Twist",
    "geometry_msgs/Pose2D",
    "geometry_msgs/Vector3",
    "sensor_msgs/BatteryState",
    "std_msgs/UInt16MultiArray",
)
_UNMEASURED = dict.fromkeys(("temperature", "current", "charge", "capacity", "design_capacity", "percentage"), math.nan)
_WHEEL_ERRORS = (
    {WheelFault.STALLED: Error.LEFT_STALLED, WheelFault.RUNAWAY: Error.LEFT_RUNAWAY},
    {WheelFault.STALLED: Error.RIGHT_STALLED, WheelFault.RUNAWAY: Error.RIGHT_RUNAWAY},
)


class SimulatedRobot:
    """Call `turn` thirty times a second; what it sends is in `device.to_host`."""

    def __init__(
        self,
        name: str,
        catalog: Catalog,
        *,
        device: SimulatedDevice | None = None,
        world: AnyWorld | None = None,
        temper: Temper = PAPER,
    ) -> None:
        self.name = name
        self._temper = temper
        self.device = SimulatedDevice() if device is None else device
        self.pose = Pose()  # as the robot believes
        self.geometry = Geometry()  # as the robot believes
        self.world = open_world() if world is None else world
        self._edges = (0, 0)  # as the encoders showed last
        self.controllers = self._new_controllers()
        self._turns = 0
        self._commanded_at_s: float | None = None
        self._is_faulted = False  # a wheel stalled or ran away
        self._has_zero = False  # a zero velocity came since
        self._now_s = 0.0
        self._is_greeted = False
        self._is_geometry_new = False  # since it was logged
        self.is_plot_silent = False  # a fault: plot_data is advertised, and none comes
        self.battery = Battery()
        self.errors = Errors()
        self._types = {name.split("/")[1]: _message_type(catalog, name) for name in _TYPES}
        self._odometry = self._advertise("odometry", "Pose2D")
        self._plot = self._advertise("plot_data", "Twist")
        self._battery = self._advertise("battery", "BatteryState")
        self._errors = self._advertise("errors", "UInt16MultiArray")
        self._subscribe_all(catalog)

    @property
    def speed_m_s(self) -> float:
        """How fast the robot truly moves forward."""
        left, right = self.wheels
        return (left.speed_m_s + right.speed_m_s) / 2

    @property
    def wheels(self) -> tuple[AnyWheel, AnyWheel]:
        """Left and right."""
        return self.world.left, self.world.right

    def turn(self, now_s: float) -> float | None:
        """One turn of the loop; None when it is done, else call again after so many seconds (the retry clause)."""
        self._now_s = now_s
        wait_s = self.device.spin(now_s)
        if wait_s is not None:
            return wait_s
        self._greet()
        is_stale = self._commanded_at_s is not None and now_s - self._commanded_at_s > WATCHDOG_S
        if is_stale and any(control.set_point.target for control in self.controllers):
            self.errors.raise_(Error.NO_COMMAND, now_s)
        if is_stale or not self.device.is_configured:
            self._command(0.0, 0.0)
            self._commanded_at_s = None
        edges = self._pass_time()
        rolled = [control.step(count, LOOP_S) for control, count in zip(self.controllers, edges, strict=True)]
        self._watch()
        self.pose = self.geometry.integrate(self.pose, *rolled)
        self._turns += 1
        if self._turns % PUBLISH_EVERY == 0:
            self._publish()
            self._report()
        return None

    def _pass_time(self) -> tuple[int, int]:
        """Let the world go on for a turn of the loop; returns the edges that each encoder counted."""
        left, right = self.controllers
        self.world.drive(left.pwm_now, right.pwm_now)
        self.world.step(LOOP_S)
        edges = self.world.left.edges, self.world.right.edges
        counted = (edges[0] - self._edges[0]) % _EDGES, (edges[1] - self._edges[1]) % _EDGES
        self._edges = edges
        return counted

    def reboot(self) -> None:
        """Power off and on: it stands at the origin of a new odometry."""
        self.device.reboot()
        self.pose = Pose()
        self.controllers = self._new_controllers()
        self._commanded_at_s = None
        self._is_faulted = self._has_zero = self._is_greeted = False

    def _new_controllers(self) -> tuple[WheelController, WheelController]:
        temper = self._temper
        return WheelController(temper.left, temper=temper), WheelController(temper.right, temper=temper)

    def _watch(self) -> None:
        """A wheel that does not follow its command stops both; they go on after a zero, when both stand."""
        if self._is_faulted:
            if not self._has_zero or not all(control.stands for control in self.controllers):
                return
            self._is_faulted = False
            for control in self.controllers:
                control.watch.forgive()
        faulty = [
            (side, control)
            for side, control in zip(("left", "right"), self.controllers, strict=True)
            if control.watch.fault is not None
        ]
        for side, control in faulty:
            self.device.log(_ERROR, f"{side} {_complaint(control)}; off until a zero", self._now_s)
        if faulty:
            self._is_faulted, self._has_zero = True, False
            self._command(0.0, 0.0)

    def _publish(self) -> None:
        left, right = self.controllers
        pose = dict(zip(("x", "y", "theta"), self.pose, strict=True))
        plot = {
            "linear": {"x": left.speed_ticks_s, "y": right.speed_ticks_s, "z": float(left.pwm)},
            "angular": {"x": left.set_point.value, "y": right.set_point.value, "z": float(right.pwm)},
        }
        self.device.publish(self._odometry, self._types["Pose2D"].encode(pose), self._now_s)
        if not self.is_plot_silent:
            self.device.publish(self._plot, self._types["Twist"].encode(plot), self._now_s)

    def _report(self) -> None:
        """The errors each second and when they change, the battery each second."""
        for control, known in zip(self.controllers, _WHEEL_ERRORS, strict=True):
            if control.watch.fault is not None:
                self.errors.raise_(known[control.watch.fault], self._now_s)
        if self.battery.add(self.world.battery_v):
            text = f"battery low: {self.battery.volts:.1f} V, below {self.battery.low_v:.1f} V"
            self.device.log(_ERROR, text, self._now_s)
        if self.battery.is_low:
            self.errors.raise_(Error.BATTERY_LOW, self._now_s)
        is_due = self._turns % (PUBLISH_EVERY * REPORT_EVERY) == 0
        numbers = self.errors.numbers(self._now_s)
        if self.errors.has_changed(numbers) or is_due:
            payload = self._types["UInt16MultiArray"].encode({"data": numbers})
            self.device.publish(self._errors, payload, self._now_s)
        if is_due:
            state = {**_UNMEASURED, "voltage": self.battery.volts, "present": True}
            self.device.publish(self._battery, self._types["BatteryState"].encode(state), self._now_s)

    def _greet(self) -> None:
        """Once configured, log it, and request the parameters; without an answer the constants apply."""
        if not self.device.is_configured:
            self._is_greeted = False
        elif not self._is_greeted:
            self._is_greeted = True
            self.device.log(_INFO, f"{self.name} is ready", self._now_s)
            self._request(tuple(PARAMETERS))

    def _request(self, names: tuple[str, ...]) -> None:
        """Request parameters, one after the other; an answer does not name its parameter."""
        if names:
            answered = partial(self._receive_parameter, names)
            self.device.request_parameter(f"/{self.name}/{names[0]}", answered, self._now_s)
        elif self._is_geometry_new:
            self._is_geometry_new = False
            for line in self.geometry.lines:
                self.device.log(_INFO, line, self._now_s)

    def _receive_parameter(self, names: tuple[str, ...], parameter: Parameter) -> None:
        name, values = names[0], parameter.floats or parameter.ints
        if PARAMETERS[name].accepts(values):
            self.geometry = self.geometry.changed(name, values)
            self._is_geometry_new = True
        elif values:
            self.errors.raise_(Error.REFUSED, self._now_s)
            self.device.log(_WARN, f"{name} refused: {PARAMETERS[name]}", self._now_s)
        self._request(names[1:])

    def _command(self, left_ticks_s: float, right_ticks_s: float) -> None:
        for control, ticks_s in zip(self.controllers, (left_ticks_s, right_ticks_s), strict=True):
            control.aim(ticks_s)

    def _receive_velocity(self, payload: bytes) -> None:
        twist: dict[str, Any] = self._types["Twist"].decode(payload)
        wanted_ticks_s = self.geometry.wheel_speeds(twist["linear"]["x"], twist["angular"]["z"])
        if not all(map(math.isfinite, wanted_ticks_s)):
            self._command(0.0, 0.0)
            self._commanded_at_s = None
            self.errors.raise_(Error.NO_NUMBER, self._now_s)
            self.device.log(_ERROR, "a velocity that is no number: stopped", self._now_s)
            return
        self._has_zero |= not any(wanted_ticks_s)
        if not self._is_faulted:
            self._commanded_at_s = self._now_s
            self._command(*wanted_ticks_s)

    def _reset(self, _: bytes) -> None:
        self.pose = Pose()

    def _tune(self, wheel: int, payload: bytes) -> None:
        gains: dict[str, Any] = self._types["Vector3"].decode(payload)
        self.controllers[wheel].pid.gains = Gains(gains["x"], gains["y"], gains["z"])

    def _advertise(self, topic: str, type_name: str) -> int:
        type_ = self._types[type_name]
        return self.device.advertise(f"/{self.name}/{topic}", type_.name, type_.md5)

    def _subscribe_all(self, catalog: Catalog) -> None:
        empty = catalog.message("std_msgs/Empty")
        for topic, type_, callback in (
            ("velocity_commands", self._types["Twist"], self._receive_velocity),
            ("reset_odometry", empty, self._reset),
            ("pid_tune_l", self._types["Vector3"], lambda payload: self._tune(0, payload)),
            ("pid_tune_r", self._types["Vector3"], lambda payload: self._tune(1, payload)),
        ):
            assert type_ is not None  # noqa: S101 - of the store that the project is built on
            self.device.subscribe(f"/{self.name}/{topic}", type_.name, type_.md5, callback)


def _complaint(control: WheelController) -> str:
    if control.watch.fault is WheelFault.STALLED:
        return f"wheel stalled: no edge at PWM {control.pwm}"
    return f"wheel runs away: {control.speed_ticks_s:.0f} of {control.set_point.value:.0f} ticks/s"


def _message_type(catalog: Catalog, name: str) -> MessageType:
    type_ = catalog.message(name)
    assert type_ is not None  # noqa: S101 - of the store that the project is built on
    return type_
