"""A contract for import-linter: a table of packages, and what each of them may import."""

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output

EVERYTHING, NOTHING = "everything", "nothing"


class ImportRows(Contract):
    """Each row is "packages: what they may import", without the root package's name.

    A module belongs to the longest name of any row that it begins with, and is imported under that name: who may import
    `cli` may not import `cli.serve` where that has a row of its own. A row may allow itself and rows above it.
    """

    rows = fields.ListField(subfield=fields.StringField())

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:  # noqa: ARG002 - as import-linter calls it
        """Broken by a module without a row, by a row that points down, and by an import that no row allows."""
        table = parse([str(row) for row in self.rows])  # type: ignore[attr-defined]
        root: str = self.session_options["root_packages"][0]
        problems = points_down(table)
        for module in sorted(graph.modules):
            name = module.removeprefix(root).lstrip(".")
            imported = [each.removeprefix(root).lstrip(".") for each in graph.find_modules_directly_imported_by(module)]
            problems += forbidden(table, name, sorted(imported)) if name else []
        return ContractCheck(kept=not problems, metadata={"problems": problems})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """A line for each."""
        for problem in check.metadata["problems"]:
            output.print_error(problem)


Table = dict[str, tuple[int, tuple[str, ...]]]  # package -> (number of its row, what it may import)


def parse(rows: list[str]) -> Table:
    """Every package with the number of its row."""
    table: Table = {}
    for number, row in enumerate(rows):
        packages, _, allowed = row.partition(":")
        names = tuple(name.strip() for name in allowed.split(",") if name.strip() != NOTHING)
        table |= {package.strip(): (number, names) for package in packages.split(",")}
    return table


def points_down(table: Table) -> list[str]:
    """Rows that allow an import of a row below them."""
    return [
        f"the row of {package} allows {name}, which has no row above"
        for package, (number, allowed) in table.items()
        for name in allowed
        if name != EVERYTHING and table.get(row_of(table, name), (number + 1,))[0] > number
    ]


def forbidden(table: Table, module: str, imported: list[str]) -> list[str]:
    """The imports of a module that its row does not allow."""
    row = row_of(table, module)
    if not row:
        return [f"{module} is in no row"]
    number, allowed = table[row]
    return [
        f"{module} must not import {other}"
        for other in imported
        if table[row_of(table, other)][0] != number and not _is_allowed(table, other, allowed)
    ]


def row_of(table: Table, module: str) -> str:
    """The longest name of any row that the module begins with; empty: there is none."""
    names = [name for name in table if f"{module}.".startswith(f"{name}.")]
    return max(names, key=len, default="")


def _is_allowed(table: Table, module: str, allowed: tuple[str, ...]) -> bool:
    """Whether the module is allowed by a name at least as long as that of its row."""
    row = row_of(table, module)
    return any(
        name == EVERYTHING or (f"{module}.".startswith(f"{name}.") and len(name) >= len(row)) for name in allowed
    )
