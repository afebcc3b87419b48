"""Full-screen table of `hostlink top`, by textual."""

from typing import Any, ClassVar

from rich.markup import escape
from textual import work
from textual.app import App, ComposeResult
from textual.binding import BindingType
from textual.containers import VerticalScroll
from textual.widgets import DataTable, Footer, Static

from hostlink.cli.figures import LINK_COLUMNS, ROBOT_COLUMNS, advice, link_rows, live_figures, robot_table
from hostlink.cli.output import plain
from hostlink.client import connect
from hostlink.errors import HostlinkError

Rows = list[tuple[str, ...]]


class TopScreen(App[None]):
    """Two tables with the findings below them. `failure` is the error that ended the screen; None if the user did."""

    CSS = """
    DataTable { height: auto; max-height: 40%; margin-bottom: 1; }
    #title { text-style: bold; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [("q,ctrl+c", "quit", "quit")]
    ENABLE_COMMAND_PALETTE = False

    def __init__(self, url: str, token: str | None, interval_s: float) -> None:
        super().__init__()
        self.failure: HostlinkError | None = None
        self._url, self._token, self._interval_s = url, token, interval_s
        self._robot_columns: tuple[str, ...] = ROBOT_COLUMNS

    def compose(self) -> ComposeResult:
        """Yield the parts of the screen."""
        yield Static(f"hostlink top   {self._url}", id="title", markup=False)
        yield DataTable(id="links", cursor_type="none", show_cursor=False)
        yield DataTable(id="robots", cursor_type="none", show_cursor=False)
        with VerticalScroll():
            yield Static("", id="advice", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        """Start to watch the daemon."""
        self.query_one("#links", DataTable).add_columns(*LINK_COLUMNS)
        self.query_one("#robots", DataTable).add_columns(*ROBOT_COLUMNS)
        self._watch()

    @work
    async def _watch(self) -> None:
        """Show figures until the app ends; a lost connection ends it."""
        try:
            async with connect(self._url, token=self._token, reconnect=False) as host:
                async for shown in live_figures(host, self._interval_s):
                    self._show(shown)
        except HostlinkError as error:
            self.failure = error
            self.exit()

    def _show(self, shown: dict[str, Any]) -> None:
        _fill(self.query_one("#links", DataTable), link_rows(shown))
        columns, rows = robot_table(shown)
        robots = self.query_one("#robots", DataTable)
        if columns != self._robot_columns:
            robots.clear(columns=True)
            robots.add_columns(*columns)
            self._robot_columns = columns
        _fill(robots, rows)
        self.query_one("#advice", Static).update("\n".join(map(plain, advice(shown))) or "no findings")


def _fill(table: "DataTable[str]", rows: Rows) -> None:
    table.clear()
    table.add_rows([escape(plain(cell)) for cell in row] for row in rows)  # textual reads [red] as a colour
