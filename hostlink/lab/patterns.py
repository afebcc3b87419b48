"""The patterns that the paper drives: marks on the floor, to be reached one after the other. Pure."""

from dataclasses import dataclass

from hostlink.lab.paper_results import LINE_M, SQUARE_SIDE_M

SIDE_M = SQUARE_SIDE_M


@dataclass(frozen=True, slots=True)
class Pattern:
    """Begins at the origin, heading along x."""

    name: str
    title: str
    short: str
    table: int  # of the paper
    marks: tuple[tuple[float, float], ...]  # x, y in metres
    is_scaled: bool = False  # its length differs from run to run, as in table 4

    def marks_of(self, run: int) -> tuple[tuple[float, float], ...]:
        """The marks of this run; the runs of a scaled pattern go through the lengths of the paper's table 4."""
        length_m = LINE_M[run % len(LINE_M)] if self.is_scaled else 1.0
        return tuple((x_m * length_m, y_m * length_m) for x_m, y_m in self.marks)


SQUARE_LEFT = Pattern(
    "square_left", "square, counterclockwise", "ccw", 2, ((SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0))
)
SQUARE_RIGHT = Pattern(
    "square_right", "square, clockwise", "cw", 3, ((SIDE_M, 0.0), (SIDE_M, -SIDE_M), (0.0, -SIDE_M), (0.0, 0.0))
)
LINE = Pattern("line", "straight line", "line", 4, ((1.0, 0.0),), is_scaled=True)
BACK = Pattern("there_and_back", "there and back", "back", 5, ((1.0, 0.0), (0.0, 0.0)), is_scaled=True)
PATTERNS = (SQUARE_LEFT, SQUARE_RIGHT, LINE, BACK)
