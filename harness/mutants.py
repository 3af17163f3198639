"""Mutants of a lab's files: bytes and words changed at random.

Every mutant is made by a number: the same number, the same mutant.
"""

import codecs
import random
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from scuhand_bt.lab import starter_lab

SOURCES = """\
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 12 g, lot: A}
  msg: {station: mortar_bay_2, container: small_agate_mortar, powder: monosodium_glutamate, amount: 6 g}
"""
POLICY = "on_failure: {dose.overshoot: flag, hand.no_flow: redo, otherwise: skip_sample}\n"
ONE = "recipe: one\nworkflow: WORKFLOW\n" + SOURCES + "samples: [{id: a, SAMPLE}]\n" + POLICY
SAMPLE = "source: beads, container: alumina_crucible, mass: 60 mg, tolerance: 5 mg"
RECIPES: Mapping[str, str] = {
    "recipes/small.yaml": "# One dose.\nrecipe: small\nsummary: one\nworkflow: fill_xrd_holder\ncontroller: paper\n"
    + SOURCES
    + "defaults: {source: beads, container: xrd_holder, tolerance: 2 %}\nsamples:\n  - {id: a, mass: 80 mg}\n"
    + POLICY,
    "recipes/lists.yaml": "recipe: lists\nworkflow: scoop_and_dispense\norder: by_powder\novershoot_limit: 3\n"
    + SOURCES
    + "defaults: {source: msg, container: pellet_die_13mm}\nsamples:\n"
    "  - {id: [x, y], mass: [100 mg, 0.2 g]}\n  - {id: z, mass: 90 mg, tolerance: 5 mg, repeat: 2}\n" + POLICY,
    "recipes/table.yaml": "recipe: table\n" + SOURCES + "samples: [{table: table.csv, tolerance: 3 mg}]\n" + POLICY,
    "recipes/table.csv": "id;source;container;mass [mg];workflow\n"
    "p-1;beads;pellet_die_13mm;120,5;fill_pellet_die\np-2;msg;xrd_holder;40;fill_xrd_holder\n",
    "recipes/both.yaml": "recipe: both\nworkflow: fill_xrd_holder\norder: as_written\n"
    + SOURCES
    + "samples:\n  - {id: a, source: beads, container: xrd_holder, mass: 40 mg}\n"
    "  - {id: b, source: msg, container: xrd_holder, mass: 40 mg}\n",
    "recipes/crucible.yaml": ONE.replace("WORKFLOW", "fill_crucible").replace("SAMPLE", SAMPLE),
    "recipes/die.yaml": ONE.replace("WORKFLOW", "fill_pellet_die").replace("SAMPLE", SAMPLE),
    "recipes/powder.yaml": ONE.replace("WORKFLOW", "characterise").replace("SAMPLE", SAMPLE),
    "recipes/day.yaml": "recipe: day\nworkflow: start_of_day\nsamples: [{id: check, weight: 20 g}]\n",
}
FAULTS: Mapping[str, str] = {
    "faults.yaml": "# What goes wrong.\nfaults:\n  - {fault: balance.draught, at_pulse: 2, for: 5 s}\n"
    "  - {fault: scoop.nothing, probability: 0.3, sample: a}\n  - {fault: valve.slow, at: 2 min, for: 30 s}\n",
    "misfortune.yaml": "faults: [{fault: scoop.nothing, probability: 1}]\n",
}
RECIPE_FOR = {
    "recipes/table.csv": "recipes/table.yaml",
    "trees/fill_crucible.yaml": "recipes/crucible.yaml",
    "trees/fill_pellet_die.yaml": "recipes/die.yaml",
    "trees/characterise.yaml": "recipes/powder.yaml",
    "trees/start_of_day.yaml": "recipes/day.yaml",
    "trees/scoop_and_dispense.yaml": "recipes/lists.yaml",
    "trees/change_powder.yaml": "recipes/both.yaml",
}
"""The recipe that uses a file; `recipes/small.yaml` uses the others."""
FAULTS_FOR = {"faults.yaml": "faults.yaml", "trees/after_failure.yaml": "misfortune.yaml"}


@dataclass(frozen=True)
class Mutant:
    """Files of a lab that are changed, the recipe that is then run, and the fault file, if one is used."""

    kind: str
    how: str
    recipe: str
    changes: Mapping[str, bytes] = field(repr=False)
    faults: str | None = None


def originals() -> dict[str, str]:
    """The files that are mutated, and those that others need, by their place in the lab."""
    lab = starter_lab()
    paths = [
        *sorted((lab / "robot").glob("*.yaml")),
        *sorted(path for path in (lab / "trees").glob("*.yaml") if ".test" not in path.name),
    ]
    return {**{str(path.relative_to(lab)): path.read_text() for path in paths}, **RECIPES, **FAULTS}


# --- bytes


def _flip_bit(data: bytearray, rng: random.Random) -> bytes:
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def _any_byte(data: bytearray, rng: random.Random) -> bytes:
    data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def _insert(data: bytearray, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    marks = bytes(rng.choice(b":-{}[],#&*!|>'\"%@`\t\r\n 0.;$\\\x00\x07\x85\xff") for _ in range(rng.randint(1, 3)))
    return bytes(data[:at]) + marks + bytes(data[at:])


def _delete(data: bytearray, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return bytes(data[:at] + data[at + rng.choice((1, 1, 2, 5, 40)) :])


def _truncate(data: bytearray, rng: random.Random) -> bytes:
    return bytes(data[: rng.randrange(len(data))])


def _duplicate(data: bytearray, rng: random.Random) -> bytes:
    at, length = rng.randrange(len(data)), rng.choice((1, 8, 60))
    return bytes(data[: at + length] + data[at:])


def _encode(data: bytearray, rng: random.Random) -> bytes:
    text = bytes(data).decode(errors="replace")
    choices: Sequence[Callable[[], bytes]] = (
        lambda: text.encode("utf-16"),
        lambda: text.encode("utf-32-le"),
        lambda: text.replace("mg", "µg").encode("latin-1", "replace"),
        lambda: codecs.BOM_UTF8 + text.encode(),
        lambda: codecs.BOM_UTF8 * 2 + text.encode(),
        lambda: text.replace("\n", "\r\n").encode(),
        lambda: text.replace("\n", "\r").encode(),
        lambda: text.replace("\n", "\u2028").encode(),
        lambda: text.replace("  ", "\t").encode(),
        lambda: text.replace(" ", "\u00a0").encode(),
    )
    return rng.choice(choices)()


# --- words

_WORD = re.compile(r"[^\s{}\[\],:;#]+")
_QUANTITY = re.compile(r"(-?\d+(?:\.\d+)?)( ?)([A-Za-z%°^/\d]*)")
UNITS = ("mg", "g", "kg", "mm", "m", "cm^3", "mL", "s", "min", "h", "deg", "rad", "%", "mg/mm^3", "mm/s", "K", "", "µg")
NUMBERS = (
    *(
        "0",
        "-0",
        "-1",
        "1e-300",
        "1e300",
        "1e400",
        "-1e30",
        "NaN",
        "nan",
        ".nan",
        "inf",
        ".inf",
        "-inf",
        "0x10",
        "1_000",
    ),
    *("1e-9", "0.1", "1,5", "٣", "½", "9" * 50, "9" * 400, "1" + "0" * 5000, "--1", "+5", "1e", "true", "1/0", "12:30"),
)
WORDS = (
    *("~", "null", "''", '""', "{}", "[]", "[[]]", "{a: 1}", "[1, 2]", "yes", "no", "on", "$mass", "$dose.error", "$"),
    *("$source.powder.belief", "$a.b.c.d", "$nothing", "as", "id", "sequence", "fill", "dose.overshoot", "../x", "/"),
    *("é", "\u202edoog", "\u200b", "😀", '"\\ud800"', '"\\0"', '"\\x07"', '"a\\nb"', "a b", "-" * 70, "x" * 3000),
    *("__class__", "model_fields", "__init__", "self", "*a", "&a", "!!python/object:os.system", "!!int", "? a", "|"),
    *("&a [*a]", "&a {b: *a}", "[" * 70 + "]" * 70, "[" * 20000, "{a: " * 70, "<<", "@", "%YAML", "`", "'", '"'),
    *("&a [&b [&c [x, x], *c, *c], *b, *b, *b]", "nan mg", "1e309 g", "5 mg mg", "5mg", "mg", "5 mg/s", "1 kg^3"),
    *("100 %", "101 %", "0 %", "-5 %", "99999", "20001", "100000", "con", "table.csv", ".", "a" * 64, "A", "Ä"),
)


def _spots(text: str) -> list[tuple[int, int]]:
    """Where the words of a text stand, comments left out."""
    found, at = [], 0
    for line in text.splitlines(keepends=True):
        code = line.split(" #")[0] if not line.startswith("#") else ""
        found += [(at + match.start(), at + match.end()) for match in _WORD.finditer(code)]
        at += len(line)
    return found or [(0, len(text))]


def _put(text: str, spot: tuple[int, int], new: str) -> str:
    return text[: spot[0]] + new + text[spot[1] :]


def _other_word(text: str, rng: random.Random) -> str:
    return _put(text, rng.choice(_spots(text)), rng.choice(WORDS))


def _neighbours_word(text: str, rng: random.Random) -> str:
    from_ = rng.choice(_spots(text))
    return _put(text, rng.choice(_spots(text)), text[slice(*from_)])


def _swap_words(text: str, rng: random.Random) -> str:
    first, second = sorted((rng.choice(_spots(text)), rng.choice(_spots(text))))
    if first == second:
        return text + text
    return _put(_put(text, second, text[slice(*first)]), first, text[slice(*second)])


def _drop_word(text: str, rng: random.Random) -> str:
    return _put(text, rng.choice(_spots(text)), "")


def _misspell(text: str, rng: random.Random) -> str:
    spot = rng.choice(_spots(text))
    word = text[slice(*spot)]
    at = rng.randrange(len(word))
    return _put(text, spot, word[:at] + rng.choice(("", "é", "x", word[at] * 2, word[at].swapcase())) + word[at + 1 :])


def _other_number(text: str, rng: random.Random) -> str:
    match = rng.choice(list(_QUANTITY.finditer(text)) or [re.search("", text)])  # type: ignore[list-item]
    number = rng.choice(NUMBERS)
    if match.re is _QUANTITY and rng.random() < 0.6:
        number = f"{float(match[1]) * rng.choice((0, -1, 1e-6, 1e-3, 0.1, 0.5, 0.9, 1.1, 2, 10, 1e3, 1e6, 1e12)):g}"
    return _put(text, match.span(1 if match.re is _QUANTITY else 0), number)


def _other_unit(text: str, rng: random.Random) -> str:
    quantities = [match for match in _QUANTITY.finditer(text) if match[3]]
    return _put(text, rng.choice(quantities).span(3), rng.choice(UNITS)) if quantities else text + " mg"


def _lines(text: str, rng: random.Random) -> str:
    """A line left out, doubled, moved, or moved in."""
    lines = text.splitlines(keepends=True)
    at, how = rng.randrange(len(lines)), rng.choice(("drop", "double", "move", "indent", "outdent"))
    line = lines[at] if how == "double" else lines.pop(at)
    line = {"indent": "  " + line, "outdent": line.removeprefix("  ")}.get(how, line)
    if how != "drop":
        lines.insert(rng.randrange(len(lines) + 1) if how == "move" else at, line)
    return "".join(lines)


def _yaml_tricks(text: str, rng: random.Random) -> str:
    spot, trick = rng.choice(_spots(text)), rng.randrange(7)
    if trick == 0:
        return text + "---\n" + text
    if trick == 1:
        return "%YAML 1.1\n%TAG ! tag:x,2000:\n---\n" + text
    if trick == 2:
        return "<<: &base {recipe: other, fault: x}\n" + text
    if trick == 3:
        return _put(text, spot, f"&a {text[slice(*spot)]}") + "\nmore: *a\n"
    if trick == 4:
        return _put(text, spot, f"!!{rng.choice(('str', 'int', 'binary', 'python/name:os', 'set'))} x")
    if trick == 5:
        laughs = "".join(f"l{i}: &l{i} [{', '.join([f'*l{i - 1}' if i else 'ha'] * 9)}]\n" for i in range(9))
        return laughs + text
    return text + "".join(" " * depth + "- \n" for depth in range(rng.choice((50, 200, 1400))))


BYTE_WAYS = (_flip_bit, _any_byte, _insert, _delete, _truncate, _duplicate, _encode)
WORD_WAYS = (
    *(_other_word, _neighbours_word, _swap_words, _drop_word, _misspell),
    *(_other_number, _other_number, _other_unit, _lines, _yaml_tricks),
)


def mutant(number: int, files: Mapping[str, str]) -> Mutant:
    """The mutant of this number, of bytes or of words: one file, changed in one place or two."""
    rng = random.Random(f"mutant {number}")
    group = rng.choice(("recipes", "recipes", "recipes", "trees", "trees", "robot", "faults"))
    path = rng.choice([name for name in files if name.startswith(group)])
    kind = "bytes" if number % 5 < 2 else "words"
    text, hows = files[path].encode(), []
    for _ in range(rng.choice((1, 1, 2))):
        if not text.strip():
            break
        if kind == "bytes":
            way = rng.choice(BYTE_WAYS)
            text = way(bytearray(text), rng)
            hows.append(way.__name__)
            if way is _encode:
                break
        else:
            word_way = rng.choice(WORD_WAYS)
            text = word_way(text.decode("utf-8"), rng).encode("utf-8", "replace")
            hows.append(word_way.__name__)
    recipe = RECIPE_FOR.get(path, path if path.startswith("recipes") else "recipes/small.yaml")
    return Mutant(kind, f"{path}: {', '.join(hows)}", recipe, {path: text}, FAULTS_FOR.get(path))
