"""A message as people write it for rostopic and ros2 topic: YAML's flow style, with bare names and words."""

import json
import re
from typing import Any

_TEXT = r'"(?:[^"\\]|\\.)*"'
_SINGLE = re.compile(rf"({_TEXT})|'((?:[^']|'')*)'")
_NAME = re.compile(rf"({_TEXT})|([A-Za-z_]\w*)(?=\s*:)")
_WORD = re.compile(rf"({_TEXT})|(?<=[:\[,])(\s*)([A-Za-z_/][^,:\[\]{{}}\"]*?)(?=\s*[,\]}}])")
_LITERALS = {"true": "true", "false": "false", "null": "null", "yes": "true", "no": "false"}


def read_message(text: str) -> Any:
    """JSON as it is; else YAML in one line, with or without the braces.

    Raises:
        ValueError: it is neither; what is wrong with it as JSON.
        RecursionError: it is nested too deeply.
    """
    try:
        return json.loads(text)
    except ValueError:
        try:
            return json.loads(_as_json(text.strip()))
        except ValueError:
            pass
        raise


def _as_json(text: str) -> str:
    """Texts, names and words get their double quotes; what has them already is passed over."""
    text = text if text.startswith(("{", "[")) else f"{{{text}}}"
    text = _SINGLE.sub(lambda found: found[1] or json.dumps(found[2].replace("''", "'")), text)
    text = _NAME.sub(lambda found: found[1] or f'"{found[2]}"', text)
    return _WORD.sub(lambda found: found[1] or found[2] + _word(found[3]), text)


def _word(word: str) -> str:
    return _LITERALS.get(word.lower()) or json.dumps(word)
