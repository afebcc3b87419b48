"""`hostlink calibrate`: find a robot's wheel radii and wheel separation by drives and a tape measure."""

import contextlib
import json as json_text
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from hostlink.cli.arguments import Token, Url, not_empty, robot_names
from hostlink.cli.calibration_picture import picture as draw
from hostlink.cli.calibration_plan import (
    SavedCalibration,
    Sizes,
    StateFile,
    Step,
    checks_of,
    default_path,
    open_state,
    steps_of,
)
from hostlink.cli.calibration_session import AtTheTerminal, CalibrationSession, Drives, Mistake, Simulated, numbers_of
from hostlink.cli.connecting import ask
from hostlink.cli.files import writing
from hostlink.cli.output import quantity, table, write, write_error
from hostlink.cli.robots import name_of
from hostlink.cli.settings import load
from hostlink.cli.settings_file import Tables, require_changeable, toml_lines, write_settings
from hostlink.client import DEFAULT_URL
from hostlink.client.course import Speed
from hostlink.core.config import CalibrationConfig
from hostlink.core.robot.odometry import OdometryCorrection
from hostlink.errors import ConfigError, HostlinkError
from hostlink.workbench.calibration import Calibration, MeasuredRun, WheelGeometry, calibrated, uncorrected
from hostlink.workbench.calibration_checks import (
    Confirmation,
    complaint_of_nominal,
    complaint_of_run,
    complaint_of_runs,
    confirm,
    doubt_of_squares,
)
from hostlink.workbench.sim.firmware_module import read, require_wasmtime

CASTER_SHARE = 0.01  # difference between the separations by turns and by squares that is reported
DEFAULT_WORLD = "track_m=0.2142\nleft.radius_m=0.0448\nright.radius_m=0.0453\n"  # a common error of each number
RADIUS_M, SEPARATION_M = (0.005, 0.5), (0.02, 5.0)  # limits of hostlink's firmware
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def command(
    robot: Annotated[
        str | None,
        typer.Argument(
            help="Name of the robot; optional if only one is connected.", callback=not_empty, autocompletion=robot_names
        ),
    ] = None,
    *,
    url: Url = DEFAULT_URL,
    token: Token = None,
    length: Annotated[
        float,
        typer.Option(
            min=0.5, max=20.0, help="Length of the line, m: shorter in a small room, longer for more precision."
        ),
    ] = 3.0,
    side: Annotated[
        float, typer.Option(min=0.5, max=10.0, help="Side of the squares, m: shorter in a small room.")
    ] = 2.0,
    turns: Annotated[
        int,
        typer.Option(
            min=0, max=50, help="Turns on the spot in each direction; 0 for a robot that cannot turn on the spot."
        ),
    ] = 5,
    repeats: Annotated[
        int,
        typer.Option(min=1, max=10, help="Number of lines, and of squares in each direction: more for more precision."),
    ] = 2,
    linear: Annotated[
        float, typer.Option(min=0.05, max=1.0, help="Speed of the drives, m/s: slower on a slippery floor.")
    ] = 0.2,
    angular: Annotated[
        float, typer.Option(min=0.1, max=4.0, help="Speed of the turns, rad/s: slower on a slippery floor.")
    ] = 0.8,
    nominal: Annotated[
        str | None,
        typer.Option(
            help="Wheels that the firmware uses, if the daemon does not know them: left radius, right radius and "
            "separation, m, for example 0.045,0.045,0.21.",
            show_default="the daemon's parameters, else the paper's",
        ),
    ] = None,
    target: Annotated[
        Literal["device", "hostlink"] | None,
        typer.Option(
            help="Where the result is used: device (parameters of hostlink's firmware) or hostlink (which corrects the "
            "odometry of other firmware).",
            show_default="by the robot's firmware",
        ),
    ] = None,
    write_to: Annotated[
        Path | None,
        typer.Option("--write", help="Write the result into this configuration file; the old file is kept as a copy."),
    ] = None,
    apply: Annotated[
        bool, typer.Option("--apply", help="Set the parameters in the running daemon, for the robot's next connection.")
    ] = False,
    state: Annotated[
        Path | None,
        typer.Option(
            help="File that keeps the finished drives, to continue on another day.", show_default="in the state folder"
        ),
    ] = None,
    anew: Annotated[bool, typer.Option("--anew", help="Begin again instead of continuing from that file.")] = False,
    picture: Annotated[
        Path | None, typer.Option(help="SVG file of the drives, for a report.", show_default="next to the state file")
    ] = None,
    simulate: Annotated[
        bool,
        typer.Option("--simulate", help="Practise with a simulated robot and person, without a daemon, in seconds."),
    ] = False,
    write_simulated: Annotated[
        bool,
        typer.Option(
            "--write-simulated", help="With --simulate: allow --write, into a configuration that no real robot uses."
        ),
    ] = False,
    world: Annotated[
        list[str] | None,
        typer.Option(
            help="With --simulate: a parameter of the simulated world, for example track_m=0.214. May be repeated."
        ),
    ] = None,
    mistake: Annotated[
        Mistake | None, typer.Option(help="With --simulate: a mistake of the person, to see how it is found.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON, for programs.")] = False,
) -> None:
    """Find a robot's wheel radii and wheel separation with a tape measure.

    The robot drives a line twice, turns on the spot in each direction, and drives a square twice in each direction.
    After each drive you enter what the tape measure shows. The result is used only if check drives confirm it.
    """
    for option, value in {"--world": world, "--mistake": mistake}.items():
        if value is not None and not simulate:
            raise ConfigError(option, "is for a simulated robot, but this would drive a real one; add --simulate")
    if simulate and write_to is not None and not write_simulated:
        raise ConfigError(
            "--write", f"{write_to} would get the numbers of a simulated robot; add --write-simulated to practise"
        )
    sizes = Sizes(length, side, turns, repeats)
    name = (robot or _only_robot(url, token, simulate=simulate)).strip("/")
    session: CalibrationSession
    if simulate:
        session = Simulated(_world(world or []), mistake)
    else:
        session = AtTheTerminal(Drives(url, token, name, Speed(linear, angular)), write_error if json else write)
    chosen = target or ("device" if session.requests_parameters() else "hostlink")
    _check_file(write_to, name, chosen)
    path = state or default_path(f"{name}-simulated" if simulate else name)
    believed = session.nominal() if nominal is None else _chosen_nominal(session, _nominal(nominal))
    saved = open_state(path, SavedCalibration(name, sizes, believed), anew=anew or simulate)
    calibration = GuidedCalibration(session, saved, picture or path.with_suffix(".svg"), is_quiet=json)
    try:
        found, confirmation = calibration.run()
    except KeyboardInterrupt:
        write_error(
            "",
            f"the robot was sent a stop; {quantity(len(saved.saved.runs), 'drive is', 'drives are')} kept in {path}",
            "run the same command to continue",
        )
        raise
    settings = settings_of(name, found.geometry, found.correction, chosen, write_to)
    if json:
        write(json_text.dumps(_as_json(found, confirmation, settings)))
    else:
        write("", "Confirmed. In hostlink.toml:", "", *toml_lines(settings))
    _keep(session, settings, chosen, write_to, apply=apply)
    saved.remove()


def _only_robot(url: str, token: str | None, *, simulate: bool) -> str:
    """Return the only robot that is connected; a simulated one needs no daemon."""
    return "robot_0" if simulate else ask(url, token, lambda host: name_of(host, None, example="hostlink calibrate {}"))


class GuidedCalibration:
    """Calibration from the first drive to its confirmation."""

    def __init__(self, session: CalibrationSession, state: StateFile, picture: Path, *, is_quiet: bool) -> None:
        self._session, self._state, self._picture = session, state, picture
        self._saved = state.saved
        self._steps = steps_of(self._saved.sizes)
        self._print = write_error if is_quiet else write  # standard output is for the JSON

    def run(self) -> tuple[Calibration, Confirmation]:
        """Drive the remaining drives and the check.

        Raises:
            HostlinkError: the measurements are impossible, the check does not confirm them, or standard input ends.
        """
        count, total = len(self._saved.runs), len(self._steps)
        self._print(
            f"Calibrating {self._saved.robot}: {total} drives, then 3 check drives"
            + ("." if count == 0 else f"; {count} are done."),
            f"Your measurements are kept in {self._state.path}; the same command continues from there.",
            "The robot uses wheels of {:g} and {:g} mm, {:g} mm apart (if not: --nominal).".format(
                *(round(1000 * value, 4) for value in self._saved.nominal)
            ),
        )
        self._state.save()  # fails before the first drive if the file cannot be written
        nominal = uncorrected(self._saved.nominal)
        for number in range(count, total):
            run = self._drive(self._steps[number], f"{number + 1}/{total}", nominal)
            self._saved.runs.append(run)
            self._state.save()
        found = self._agree()
        self._describe(found)
        return found, self._check(found)

    def _drive(self, step: Step, place: str, correction: OdometryCorrection) -> MeasuredRun:
        """One drive, until its numbers can be."""
        path = None
        while True:
            if path is None:
                self._session.prepare(step, place)
                try:
                    path = self._session.follow(step.legs, correction)
                except HostlinkError as error:
                    if not self._session.is_patient:
                        raise
                    write_error(f"  {error}")
                    continue
            run = MeasuredRun(step.kind, step.size, path, self._session.measure(step))
            complaint = complaint_of_run(run, correction)
            if not complaint:
                return run
            if self._session.drives_again(complaint):
                path = None

    def _agree(self) -> Calibration:
        """Find the wheels that explain all drives; repeat drives that contradict the others.

        Raises:
            HostlinkError: the person does not repeat a contradicting drive, or entered the squares in a wrong unit.
        """
        runs = self._saved.runs
        while complaint := complaint_of_runs(runs, self._saved.nominal):
            titles = [f"{step.title}: {_entered(run)}" for step, run in zip(self._steps, runs, strict=True)]
            number = self._session.choose(complaint, titles)
            if number is None:
                raise HostlinkError(f"{complaint}. No result is used; run the same command to measure drives again")
            runs[number] = self._drive(self._steps[number], f"{number + 1} again", uncorrected(self._saved.nominal))
            self._saved.checks.clear()
            self._state.save()
        if self._session.is_patient and (doubt := doubt_of_squares(runs)) and not self._session.goes_on(doubt):
            raise HostlinkError("no result is used; run the same command with --anew to measure all drives again")
        return calibrated(runs, self._saved.nominal)

    def _check(self, found: Calibration) -> Confirmation:
        steps, checks = checks_of(self._saved.sizes), self._saved.checks
        for number in range(len(checks), len(steps)):
            checks.append(self._drive(steps[number], f"check {number + 1}/{len(steps)}", found.correction))
            self._state.save()
        confirmation = confirm(found, checks)
        self._draw(found)
        self._print(
            "",
            f"Check drives: the position is {confirmation.before_m * 100:.1f} cm off with the old numbers, "
            f"{confirmation.after_m * 100:.1f} cm with the new ones.",
            f"Picture: {self._picture}",
        )
        if confirmation.complaint:
            checks.clear()
            self._state.save()
            raise HostlinkError(confirmation.complaint)
        return confirmation

    def _draw(self, found: Calibration) -> None:
        with writing(self._picture, "the drives are kept, so run the same command with another --picture"):
            self._picture.parent.mkdir(parents=True, exist_ok=True)
            self._picture.write_text(draw(found, self._saved.runs, self._saved.checks), encoding="utf-8")

    def _describe(self, found: Calibration) -> None:
        now, new, width, umbmark = found.nominal, found.geometry, found.deviations, found.umbmark_geometry
        names = ("left wheel, radius", "right wheel, radius", "wheels, apart")
        rows = [
            [name, *(f"{1000 * value:.3f}" for value in (old, best)), f"± {1000 * half:.3f}", f"{1000 * other:.3f}"]
            for name, old, best, half, other in zip(names, now, new, width, umbmark, strict=True)
        ]
        self._print(
            *table(["mm", "now", "least squares", "95 %", "UMBmark"], rows),
            "",
            f"A square ends {found.before.largest_m * 100:.1f} cm off now, and {found.after.largest_m * 100:.2f} cm "
            f"with these numbers (mean of the drives, E_max,syst); a single one {found.residual_m * 100:.2f} cm.",
        )
        if (by_turns_m := found.separation_by_turns_m) is not None:
            share = by_turns_m / found.correction.separation_m - 1
            if abs(share) > CASTER_SHARE:
                self._print(
                    f"Turns on the spot give a separation of {by_turns_m * 1000:.2f} mm: each corner of a square turns "
                    f"{share * 90:+.1f} degrees more than a turn on the spot. A caster that swings round at the "
                    "beginning of a side does that; the numbers above are right for drives with corners."
                )


def settings_of(
    robot: str, geometry: WheelGeometry, correction: OdometryCorrection, target: str, file: Path | None
) -> Tables:
    """Return the settings for hostlink.toml, with the keys that the file has already."""
    if target == "hostlink":
        values = {
            "left_factor": f"{correction.left_factor:.6f}",
            "right_factor": f"{correction.right_factor:.6f}",
            "nominal_separation_m": f"{correction.nominal_separation_m:.6g}",
            "separation_m": f"{correction.separation_m:.6f}",
        }
        table = f"robots.{robot if _BARE_KEY.fullmatch(robot) else json_text.dumps(robot)}"
        return {table: {"kinematics": '"differential"'}, f"{table}.calibration": values}
    radii = f"[{geometry.left_radius_m:.7f}, {geometry.right_radius_m:.7f}]"
    own = {"wheel_radius": radii, "wheel_separation": f"{geometry.separation_m:.6f}"}
    known = [] if file is None else list(load(file).parameters)
    return {"parameters": {_spelling(f"/{robot}/{name}", known): value for name, value in own.items()}}


def _keep(session: CalibrationSession, settings: Tables, target: str, file: Path | None, *, apply: bool) -> None:
    if file is not None:
        backup = write_settings(file, settings)
        write_error(f"{file} is changed; the old file is {backup}. Restart the daemon and the robot to use it.")
    if apply and target == "device":
        session.set_parameters({json_text.loads(key): value for key, value in settings["parameters"].items()})
        write_error("The daemon has the parameters; reset the robot, which requests them when it connects.")
    elif apply:
        write_error("--apply sets parameters only: hostlink reads the correction of odometry from its configuration.")


def _check_file(file: Path | None, robot: str, target: str) -> None:
    """Refuse a file that cannot have the result, before an hour of drives."""
    if file is None:
        return
    config = load(file)
    is_corrected = robot in config.robots and config.robots[robot].calibration != CalibrationConfig()
    if target == "device" and is_corrected:
        raise ConfigError(
            str(file),
            f"has [robots.{robot}.calibration], which would correct the device's new numbers again; remove it",
        )
    require_changeable(file, settings_of(robot, WheelGeometry(), OdometryCorrection(), target, file))


def _spelling(name: str, known: list[str]) -> str:
    """Return the file's spelling of a parameter: `~robot_0/x` and `robot_0/x` are the same as `/robot_0/x`."""
    return json_text.dumps(next((key for key in known if key.lstrip("/~") == name.lstrip("/~")), name))


def _world(changes: list[str]) -> Any:
    require_wasmtime("--simulate")
    try:
        return read(DEFAULT_WORLD + "\n".join(changes))
    except ValueError as error:
        raise ConfigError("--world", str(error).partition(": ")[2]) from error  # without the number of the line


def _chosen_nominal(session: CalibrationSession, nominal: WheelGeometry) -> WheelGeometry:
    """Return the wheels of `--nominal`.

    Raises:
        ConfigError: their unit seems wrong, and the person agrees.
    """
    complaint = ""
    with contextlib.suppress(
        HostlinkError
    ):  # the daemon does not know what the robot uses, which is why the option was given
        complaint = complaint_of_nominal(nominal, session.nominal())
    if complaint and not session.goes_on(complaint):
        raise ConfigError("--nominal", complaint)
    return nominal


def _nominal(text: str) -> WheelGeometry:
    values = numbers_of(text)
    if len(values) != len(WheelGeometry._fields):
        raise ConfigError("--nominal", f"{text} is not three numbers; enter metres, for example 0.045,0.045,0.21")
    for value, (least_m, most_m) in zip(values, (RADIUS_M, RADIUS_M, SEPARATION_M), strict=True):
        if not least_m <= value <= most_m:
            raise ConfigError(
                "--nominal",
                f"{value:g} m is outside {least_m:g} to {most_m:g} m; enter metres, for example 0.045,0.045,0.21",
            )
    return WheelGeometry(*values)


def _entered(run: MeasuredRun) -> str:
    x_m, y_m, theta_rad = run.measured
    if theta_rad is not None:
        return f"{theta_rad:.3f} rad"
    return f"{x_m * 100:.1f} cm forward, {y_m * 100:.1f} cm to the left"


def _as_json(found: Calibration, confirmation: Confirmation, settings: Tables) -> dict[str, Any]:
    return {
        "nominal": found.nominal._asdict(),
        "wheels": found.geometry._asdict(),
        "deviations_95": found.deviations._asdict(),
        "umbmark": found.umbmark_geometry._asdict(),
        "separation_by_turns_m": found.separation_by_turns_m,
        "before_m": found.before.largest_m,
        "after_m": found.after.largest_m,
        "check_before_m": confirmation.before_m,
        "check_after_m": confirmation.after_m,
        "settings": toml_lines(settings),
    }
