"""SentCommands: arrived, superseded and lost commands."""

from tools.sent_commands import SentCommands


def sent(*numbers: int) -> SentCommands:
    commands = SentCommands()
    for at_s, number in enumerate(numbers):
        commands.send(number, float(at_s))
    return commands


def test_arrived_commands_and_stops_have_separate_latencies() -> None:
    commands = sent(1, 2, 0, 3)
    for number, at_s in ((1, 0.5), (1, 0.6), (2, 1.25), (0, 2.5), (0, 2.6), (3, 3.5)):
        commands.receive(number, at_s)
    assert (commands.latencies_s, commands.stops_s) == ([0.5, 0.25, 0.5], [0.5])
    assert (commands.superseded, commands.lost) == (0, 0)


def test_a_stop_and_a_command_that_come_in_one_turn_are_the_newer_one() -> None:
    commands = sent(1, 0, 2, 3)
    commands.receive(1, 0.5)
    commands.receive(2, 2.5)
    assert (commands.superseded, commands.lost) == (1, 1)
    assert (commands.latencies_s, commands.stops_s) == ([0.5, 0.5], [])


def test_command_without_a_newer_one_is_lost() -> None:
    commands = sent(1, 2, 0)
    commands.receive(1, 0.5)
    assert (commands.superseded, commands.lost) == (0, 2)
