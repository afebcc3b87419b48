"""Report: what a run came to, for people. Pure."""

from tests.support.chaos.run import Outcome


def describe(outcome: Outcome) -> str:
    """Return a few lines; a failure has everything that is needed to repeat it."""
    figures = "  ".join(f"{name} {_short(value)}" for name, value in outcome.figures.items())
    lines = [f"seed {outcome.wanted.seed}: {outcome.steps} steps, {len(outcome.violations)} violations", f"  {figures}"]
    lines += [f"FAILED seed {outcome.wanted.seed}, {violation}" for violation in outcome.violations]
    if outcome.violations:
        lines.append("  what was under way at the first:")
        lines += [f"    {what}" for what in outcome.violations[0].under_way]
        lines.append(f"  again: {outcome.wanted.command()}")
    return "\n".join(lines)


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
