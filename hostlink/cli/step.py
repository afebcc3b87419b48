"""`hostlink step`: drive a step of speed, and show how the robot follows; or identify its motors, and tune its PID."""

import asyncio
import json as json_text
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from hostlink.cli.arguments import Token, Url
from hostlink.cli.connecting import connected
from hostlink.cli.output import show_progress, write, write_error
from hostlink.cli.step_picture import draw_picture, require_picture
from hostlink.cli.step_recorder import (
    Recording,
    StepRecorder,
    connected_state,
    find_source,
    require_robot,
    separation_of,
)
from hostlink.cli.step_report import notes_of, record_views, step_lines
from hostlink.cli.step_stages import Stage, Wheel, describe_way, make_stage, rising_stages
from hostlink.cli.step_tuning import tune
from hostlink.client import DEFAULT_URL, Host
from hostlink.errors import ConfigError
from hostlink.robot.step_response import FULL_PWM, step_figures

STEP_S = 6.0
LEAST_SPEED_M_S, MOST_SPEED_M_S = 0.02, 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Request:
    robot: str
    speed_m_s: float
    seconds: float
    wheel: Wheel | None
    tunes: bool
    sends: bool
    is_confirmed: bool
    as_json: bool
    full_pwm: float
    picture: Path | None


def command(
    robot: Annotated[str, typer.Argument(help="Its name.", show_default=False)],
    *,
    speed: Annotated[float, typer.Option(help="Of the wheels, m/s; below zero: backwards.")] = 0.2,
    wheel: Annotated[
        Wheel | None, typer.Option(help="This wheel alone; the other stands.", show_default="both, straight ahead")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=2.0, max=60.0, help="How long a step lasts.", show_default=f"{STEP_S:g}")
    ] = None,
    tune: Annotated[
        bool, typer.Option("--tune", "--relay", help="Identify the motors by rising steps, and compute PID gains.")
    ] = False,
    send: Annotated[bool, typer.Option("--send", help="With --tune: send the gains to the robot.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="There is room for the way; do not ask.")] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the speeds into this file: .png, .svg or .pdf.", show_default=False)
    ] = None,
    full_pwm: Annotated[float, typer.Option(min=1.0, help="The robot's full PWM, to find saturation.")] = FULL_PWM,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Annotated[bool, typer.Option("--json", help="For programs; needs --yes.")] = False,
) -> None:
    """Drive a step of speed, and show how the robot follows it. It moves: the way is shown first.

    Rise time, overshoot, settling time, steady error, dead time and saturation of each wheel, from the robot's
    plot_data; of a robot without it from odometry. Ctrl-C stops the robot at once.
    """
    if not LEAST_SPEED_M_S <= abs(speed) <= MOST_SPEED_M_S:
        raise ConfigError("--speed", f"{speed:g} m/s is not {LEAST_SPEED_M_S:g} to {MOST_SPEED_M_S:g}, either way")
    if send and not tune:
        raise ConfigError("--send", "sends the gains that --tune computes; name both")
    if tune and seconds is not None:
        raise ConfigError("--seconds", "is of a single step: --tune drives rising ones of lengths of its own")
    if not yes and (json or not sys.stdin.isatty()):
        raise ConfigError("--yes", "is needed where nobody can be asked: the robot will move")
    if picture is not None:
        require_picture(picture)
    request = _Request(
        robot=robot,
        speed_m_s=speed,
        seconds=STEP_S if seconds is None else seconds,
        wheel=wheel,
        tunes=tune,
        sends=send,
        is_confirmed=yes,
        as_json=json,
        full_pwm=full_pwm,
        picture=picture,
    )
    way = asyncio.run(_describe(url, token, request))  # without a connection nobody waits while a person reads
    if not json:
        write_error(f"{way}.")
    if not yes:
        typer.confirm("Is there room?", abort=True, err=True)
    asyncio.run(_step(url, token, request))


async def _describe(url: str, token: str | None, request: _Request) -> str:
    async with connected(url, token) as host:
        robot = await require_robot(host, request.robot)
        state = await connected_state(robot)
        separation_m = await separation_of(host, robot.name)
        await find_source(host, state, request.wheel, separation_m)
        return describe_way(robot.name, _stages(request, separation_m), request.wheel, separation_m)


async def _step(url: str, token: str | None, request: _Request) -> None:
    async with connected(url, token) as host:
        robot = await require_robot(host, request.robot)
        separation_m = await separation_of(host, robot.name)
        source = await find_source(host, await connected_state(robot), request.wheel, separation_m)
        stages = _stages(request, separation_m)
        try:
            recording = await StepRecorder(host, robot, source, show=show_progress).record(stages)
        finally:
            show_progress("")
        notes = notes_of(stages[-1], recording.accepted, recording.records)
        if request.picture is not None:
            title = f"{robot.name}: {'rising steps' if request.tunes else 'step'} to {request.speed_m_s:g} m/s"
            notes += _draw(request.picture, title, recording)
        if request.tunes:
            await _report_tuning(host, robot.name, recording, notes, request)
        else:
            _report_step(robot.name, recording, notes, request)


def _draw(picture: Path, title: str, recording: Recording) -> list[str]:
    """A picture that fails costs no figures: the robot has driven for them."""
    try:
        draw_picture(picture, title, recording.records)
    except OSError as error:
        return [f"no picture: {picture}: {error.strerror or error}"]
    return []


def _stages(request: _Request, separation_m: float) -> tuple[Stage, ...]:
    if request.tunes:
        return rising_stages(request.speed_m_s, request.wheel, separation_m)
    return (make_stage(request.speed_m_s, request.seconds, request.wheel, separation_m),)


def _report_step(name: str, recording: Recording, notes: list[str], request: _Request) -> None:
    figures = {side: step_figures(record, full_pwm=request.full_pwm) for side, record in recording.records.items()}
    if request.as_json:
        wheels = record_views(recording.records, figures)
        view = {"robot": name, "source": recording.source, "speed_m_s": request.speed_m_s, "wheels": wheels}
        write(json_text.dumps(view | {"notes": notes}))
        return
    write(*step_lines(figures, {side: record.unit for side, record in recording.records.items()}))
    write(*(f"note: {note}" for note in notes))


async def _report_tuning(host: Host, name: str, recording: Recording, notes: list[str], request: _Request) -> None:
    tuned = await tune(host, name, recording.records, sends=request.sends)
    if request.as_json:
        view = {"robot": name, "source": recording.source, "speed_m_s": request.speed_m_s, "notes": notes}
        write(json_text.dumps(view | tuned.view(recording.records)))
        return
    write(*tuned.lines(), *(f"note: {note}" for note in notes))
