"""Text of devices and programs for people: safe for a terminal, and for a cell of a spreadsheet."""

import json

_BEGINS_FORMULA = tuple("=+-@")  # https://owasp.org/www-community/attacks/CSV_Injection


def plain(text: str) -> str:
    """Return the text in one line, with unprintable characters escaped as in JSON: JSON keeps its meaning.

    Escaped are control characters (ESC, C1), marks that change the direction of reading, and ends of lines.
    """
    return text if text.isprintable() else "".join(map(_escaped, text))


def csv_text(text: str) -> str:
    """Return the text for a cell of CSV: plain lines, and an apostrophe before what a spreadsheet would execute."""
    known = text.encode(errors="replace").decode()  # JSON may contain half a surrogate pair
    found = "\n".join(map(plain, known.split("\n")))
    return f"'{found}" if found.lstrip().startswith(_BEGINS_FORMULA) else found


def _escaped(char: str) -> str:
    return char if char.isprintable() else json.dumps(char)[1:-1]
