"""The rows of imports: the longest name counts, rows point up, nothing is in no row."""

import pytest

from tools.import_rows import forbidden, parse, points_down, row_of

TABLE = parse(
    [
        "errors, latency: nothing",
        "hub: errors, link.base",
        "cli: errors",
        "cli.serve: everything",
    ]
)


@pytest.mark.parametrize(
    ("module", "row"),
    [("errors", "errors"), ("hub.robots", "hub"), ("cli.output", "cli"), ("cli.serve", "cli.serve"), ("hubs", "")],
)
def test_a_module_belongs_to_the_longest_name(module: str, row: str) -> None:
    assert row_of(TABLE, module) == row


def test_import_that_no_row_allows_is_forbidden() -> None:
    assert forbidden(TABLE, "errors", ["latency"]) == []
    assert forbidden(TABLE, "hub.robots", ["errors", "hub.hub"]) == []
    assert forbidden(TABLE, "hub.robots", ["latency"]) == ["hub.robots must not import latency"]
    assert forbidden(TABLE, "cli.serve", ["hub.hub", "cli.output"]) == []


def test_a_row_of_its_own_is_not_allowed_by_a_shorter_name() -> None:
    assert forbidden(TABLE, "cli.output", ["cli.serve"]) == ["cli.output must not import cli.serve"]


def test_a_module_of_no_row_is_named() -> None:
    assert forbidden(TABLE, "new.module", []) == ["new.module is in no row"]


def test_a_row_allows_only_what_stands_above_it() -> None:
    assert points_down(parse(["errors: hub", "hub: nothing"])) == [
        "the row of errors allows hub, which has no row above"
    ]
    assert points_down(TABLE) == ["the row of hub allows link.base, which has no row above"]
