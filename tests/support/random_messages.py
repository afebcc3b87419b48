"""Messages, payloads and definitions of any type, out of a random generator: as many a second as a batch needs."""

import struct
from random import Random

from hostlink.core.messages.fields import FLOATS, FORMATS, SCALAR, VARIABLE, Field, Layout, integer_range

ELEMENTS_MAX = 3
TEXTS = ("", "a", "left_wheel", "µ-Ω", "x" * 40, "a\tb\n", "\u20ac\U0001f916")
CORNERS = (0.0, -0.0, 1.0, -1.5, float("inf"), float("-inf"), float("nan"), 3.4028234663852886e38, 1.17549435e-38)


def random_message(random: Random, layout: Layout) -> dict[str, object]:
    """A message that the layout can have."""
    return {field.name: _field(random, layout, field) for field in layout.fields}


def _field(random: Random, layout: Layout, field: Field) -> object:
    if field.array_length == SCALAR:
        return _one(random, layout, field)
    count = random.randint(0, ELEMENTS_MAX) if field.array_length == VARIABLE else field.array_length
    if field.is_octets:
        return random.randbytes(count)
    return [_one(random, layout, field) for _ in range(count)]


def _one(random: Random, layout: Layout, field: Field) -> object:
    if field.type == "string":
        return random.choice(TEXTS)
    if field.type in FLOATS:
        return random.choice(CORNERS) if random.random() < 0.3 else random.gauss(0.0, 10.0 ** random.randint(-9, 9))
    if field.type in FORMATS:
        values = integer_range(field.type)
        return bool(random.getrandbits(1)) if field.type == "bool" else random.choice((values[0], values[-1], 1, 0))
    return random_message(random, layout.nested[field.type])


def damaged(random: Random, payload: bytes) -> bytes:
    """The payload cut, or with a length that is a lie, or with other bytes."""
    line = bytearray(payload)
    match random.randrange(4):
        case 0:
            del line[random.randint(0, len(line)) :]
        case 1 if len(line) >= 4:
            at = random.randint(0, len(line) - 4)
            struct.pack_into("<I", line, at, random.choice((0, 1, 5, 255, 65535, 65536, 2**31, 2**32 - 1, 2**32 - 4)))
        case 2:
            line += random.randbytes(random.randint(1, 9))
        case _:
            for _ in range(random.randint(1, 4)):
                if line:
                    line[random.randrange(len(line))] = random.getrandbits(8)
    return bytes(line)


def random_package(random: Random, name: str) -> dict[str, str]:
    """Definitions by their names, of which later ones contain earlier ones."""
    texts: dict[str, str] = {}
    for number in range(random.randint(1, 6)):
        known = [*FORMATS, "string", "time", "duration", "Header", *texts, "geometry_msgs/Point"]
        lines = [_constant(random, index) for index in range(random.randint(0, 4))]
        for index in range(random.randint(0, 7)):
            type_name = random.choice(known)
            array = random.choice(("", "", "", "[]", "[]", f"[{random.randint(1, 5)}]"))
            lines.append(f"{type_name}{array} {_name(random, index)}")
        texts[f"{name}/Type{number}"] = "\n".join(lines) + "\n"
    return texts


# Names that mean something else to C++, to Arduino.h or to the generated class.
HARD_NAMES = (
    "class",
    "default",
    "int",
    "HIGH",
    "PI",
    "serialize",
    "deserialize",
    "getType",
    "in",
    "out",
    "new",
    "min",
    "max",
)


def _name(random: Random, index: int) -> str:
    if random.random() < 0.3:
        return HARD_NAMES[index * 5 % len(HARD_NAMES)]
    return random.choice(("value{}", "Value_{}", "data{}_length", "x{}")).format(index)


def _constant(random: Random, index: int) -> str:
    type_name = random.choice((*FORMATS, "string"))
    if type_name == "string":
        value = random.choice(("plain", 'write "??=" \\ # no comment', "µ", ""))
    elif type_name in FLOATS:
        value = random.choice(("0", "1", "-0.05", "1e300", "-1e-300", "nan", "inf", "-inf", "3.5e38", "1_0.5"))
    else:
        values = integer_range(type_name)
        value = str(random.choice((values[0], values[-1], 0, 1)))
    return f"{type_name} CONSTANT_{index}={value}"
