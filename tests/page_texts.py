"""The texts of the pages, read from the scripts that draw them and from the tables of the gateway: what a language's
file translates. `./dev translations` lists what each file lacks.

A text between tags, an attribute that people read, and every other string of the scripts that reads like words; values
in it become {0}, {1}, as in lib/page.js.
"""

import ast
import inspect
import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from gateway.alarms import definition
from gateway.alarms.bay_alarms import BAY_ALARMS
from gateway.alarms.gateway_alarms import GATEWAY_ALARMS
from gateway.alarms.states import AlarmEvent, AlarmState
from gateway.config import GatewayConfig
from gateway.core import detection, events, ne107, plc, readings, state, teach_in, visit_summary
from gateway.explained import ExplainedInt, ExplainedStr
from gateway.records import page, sentences
from gateway.records.alarm_rates import BENCHMARKS
from gateway.sinks import registry
from gateway.vision.detect.paper import tuning_view as paper_view
from gateway.vision.detect.robust import tuning_view as robust_view
from gateway.vision.detect.robust.method import REJECTIONS
from gateway.vision.offline.calibration import solve
from gateway.vision.offline.tuning import exposure, thresholds
from gateway.web.history.records_thread import NOT_RECORDED
from gateway.web.languages import languages
from gateway.web.manager import collected
from gateway.web.profile import parameter_schema, settings_model
from gateway.web.testsets import scoring
from gateway.web.tuning import eyedropper, marker_pick, remarks
from gateway.web.tuning import teach_in as teach_ins

STATIC = Path(__file__).parents[1] / "gateway" / "web" / "static"
DESK = sorted(
    path
    for path in STATIC.rglob("*.js")
    if "vendor" not in path.parts and path.name not in {"driver.js", "sound.js", "ambient.js", "symbols.js"}
)
OPERATOR = (
    STATIC / "operator" / "operator.js",
    STATIC / "login.js",
)  # complete in every language
# Strings that read like words and are none, or that are the same in every language.
NOT_TEXTS = {
    "'Segoe UI', Roboto, 'Noto Sans', 'Liberation Sans', sans-serif", "(prefers-color-scheme: dark)",
    "(max-width: 700px) and not print", "(min-width: 1700px)", "(prefers-reduced-motion: reduce)", "rgb({0}, {1}, {2})",
    "back", "[name='{0}'], [name^='{1}.']", "[records]", "enabled = true", "[records] enabled = true",
    "#rrggbb", "more false", "more wrong", "test set {0}/{1}: {2}", "the marker is refused: {0}",
    'state_dir = "/var/lib/loading-gateway"', "guidance.aim_u_px", "state_dir", "this picture", "pick-mode",
    "the score goes on: {0}", "no picture: {0}", "{0}{1}h {2}{3}min", "{0}{1}min {2}{3}s",
    "({0}, {1}) lies beside the picture of {2} x {3} px", "Value error, ", "id = {0}  # of [[recipes]]",
    'name = "{0}"  # of [[bays]]', "not allowed: {0}: {1}",
}  # fmt: skip
READ = {
    *("aria-label", "title", "placeholder", "alt", "aria-valuetext", "label", "name", "text", "note", "more", "unit"),
    "data-name",  # on narrow screens
}
VALUE = "\x00"  # stands for an expression in a template
NAME = "\x01"  # for one whose value is no number: a name, or a text that is looked up by itself
NAMES = {"name", "fault", "before.who", "', '.join(cut)", "_not_good(state)", "' '.join(str(error).split())"}
# Single words that stand in the scripts as plain strings, where they can't be told from names of fields.
WORDS = {
    "off", "yes", "no", "To go", "radius of the marker in the picture", "distance to the truck",
    "Live", "History", "Report", "Tuning", "Lens", "Manual", "light", "dark",
    "active", "sound", "1 alarm", "Acknowledge", "Reset", "Shelve", "Remove",
    "on", "unknowable", "failure", "high", "medium", "low", "technician", "viewer", "Today", "Yesterday",
    "hour", "day", "to", "View", "theme", "units", "language", "Freeze", "Upload…", "default",
    "Show", "Hide", "noise",
    "STOP", "OK", "LIVE", "NOT LIVE", "shelved", "sensors", "service",
    "age", "delay", "brightness", "contrast", "sharpness", "veil", "shift", "exposure", "gain", "heartbeat", "recipe",
    "writes", "conflicts", "exceptions", "delivered", "failed", "dropped", "reconnects",
    "vision", "range", "events", "Play", "neither", "acceptable", "manageable", "announced", "damaged",
    "requests", "waiting", "rate",
    "hue", "saturation", "value", "upper", "lower", "width", "height", "Freezing…", "Recording…", "Uploading…",
    "choose…", "Adding…", "Make", "Rename", "seen", "missing", "Taken.", "checkerboard", "circles", "Fault",
    "Warning", "Waiting", "well", "warning", "warnings", "fault", "faults", "required", "absent", "empty", "tried",
    "label", "kept", "missed",
}  # fmt: skip
# As in lib/page.js: what has no word but units, names of values and paths of drawings is no text.
_WORD = re.compile(r"[^\W\d_]{2}")
_NO_WORD = re.compile(
    r"(?<![^\W_])(?:[mcdk]?m|px²?|in|ft|[mµ]s|Hz|dB|MB|MiB|GiB)(?![^\W_])|_th\b|^M\d[\d.\sMLHVZAQCSTmlhvzaqcst-]*$"
)
_TAG = re.compile(r"<[^<>]*>")
_ATTRIBUTE = re.compile(r"([\w-]+)=(?:\"([^\"]*)\"|'([^']*)')")


class _Literal(NamedTuple):
    where: str  # "markup", "code", or the attribute whose value it is
    text: str  # with VALUE for each expression
    values: tuple[str, ...] = ()  # the expressions


def _skip_string(text: str, at: int) -> int:
    quote = text[at]
    at += 1
    while text[at] != quote:
        at += 2 if text[at] == "\\" else 1
    return at + 1


def _template(text: str, at: int, markup: bool, where: str) -> tuple[int, list[_Literal]]:
    """From behind the backtick to behind the closing one: the end, and what was read."""
    found: list[_Literal] = []
    values: list[str] = []
    static = ""
    while text[at] != "`":
        if text[at] == "\\":
            static += text[at : at + 2]
            at += 2
        elif text.startswith("${", at):
            begin = at + 2
            at, inner = _code(text, begin, _attribute(static) if markup else where)
            found += inner
            values.append(text[begin : at - 1])
            static += VALUE
        else:
            static += text[at]
            at += 1
    found.append(_Literal("markup" if markup else where or "code", static, tuple(values)))
    return at + 1, found


def _attribute(static: str) -> str:
    """Whose value comes after this; of a component: "code", as it may be drawn; empty: none."""
    found = re.search(r"([\w-]+)=[\"']?[^\"'<>\s]*$", static)
    if found is None:
        return ""
    of_component = static.rpartition("<")[2].startswith(VALUE)
    return "code" if of_component and found[1] not in READ else found[1]


def _code(text: str, at: int, where: str) -> tuple[int, list[_Literal]]:
    """Until the brace that closes, or the end."""
    found: list[_Literal] = []
    depth = 0
    while at < len(text):
        c = text[at]
        if text.startswith("//", at) and (at == 0 or text[at - 1] != ":"):
            at = text.find("\n", at)
            if at < 0:
                return len(text), found
        elif text.startswith("/*", at):
            at = text.index("*/", at) + 2
        elif c in "'\"":
            end = _skip_string(text, at)
            found.append(_Literal(where or "code", text[at + 1 : end - 1]))
            at = end
        elif c == "`":
            at, inner = _template(text, at + 1, text[:at].endswith("html"), where)
            found += inner
        elif c == "/" and re.search(r"[(,=:[!&|?{;]\s*$", text[max(0, at - 20) : at]):  # a regular expression
            at += 1
            in_set = False
            while text[at] != "/" or in_set:
                in_set = (in_set or text[at] == "[") and text[at] != "]"
                at += 2 if text[at] == "\\" else 1
            at += 1
        elif c == "{":
            depth += 1
            at += 1
        elif c == "}":
            if depth == 0 and where is not None and text[:at].count("`"):
                return at + 1, found
            depth -= 1
            at += 1
        else:
            at += 1
    return at, found


def _clean(text: str) -> str:
    text = re.sub(r"\\u([0-9a-f]{4})", lambda code: chr(int(code[1], 16)), text.replace("\\n", " "))
    text = re.sub(r"\\(.)", r"\1", text).replace("&nbsp;", "\u00a0")
    return re.sub(r"^[\s·:;,.()–-]+$", "", text.strip())


def _numbered(text: str) -> str:
    """As lib/page.js makes a key: numbers and values are {0}, {1}."""
    n = itertools.count()
    return re.sub(VALUE + r"|[+\u2212-]?\d+(?:[.,:\u202f]\d+)*", lambda _: f"{{{next(n)}}}", text)


def _of_markup(static: str) -> Iterator[str]:
    for tag in _TAG.findall(static):
        for name, double, single in _ATTRIBUTE.findall(tag):
            if name in READ and VALUE not in double + single:
                yield double or single
    yield from re.split(VALUE, _TAG.sub(VALUE, static))


def texts_of(script: Path) -> set[str]:
    """Keys of one script."""
    _, literals = _code(script.read_text(encoding="utf-8"), 0, "")
    found: set[str] = set()
    for where, literal, _ in literals:
        if where == "markup":
            found |= {_clean(run) for run in _of_markup(literal)}
        elif where in READ or (where in {"", "code"} and " " in literal.strip()):
            found.add(_numbered(_clean(literal)) if VALUE in literal else _clean(literal))
    return {text for text in found if _words(text)}


def _words(text: str) -> bool:
    return _WORD.search(_NO_WORD.sub("", re.sub(r"\{\d\}", "", text))) is not None


def literals_of(script: Path) -> set[str]:
    """All strings of one script, whatever they are for."""
    found: set[str] = set()
    for where, literal, _ in _code(script.read_text(encoding="utf-8"), 0, "")[1]:
        markup = {*_of_markup(literal), *re.findall(r'="([^"]*)"', literal)} if where == "markup" else set()
        found |= {_clean(text) for text in (literal, *markup)}
    return found


def templates_of(script: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Texts of one script with values in them that are looked up when they are drawn: the values' expressions."""
    _, literals = _code(script.read_text(encoding="utf-8"), 0, "")
    for where, literal, values in literals:
        text = _numbered(_clean(literal))
        if (
            values
            and (where in READ or where in {"", "code"})
            and _words(text)
            and " " in text
            and text not in NOT_TEXTS
        ):
            yield text, values


def of_the_states() -> set[str]:
    """What the operator's page shows of the gateway's own tables: meanings, and names of states as words."""
    found: set[str] = set()
    for module in (detection, ne107, plc, readings, state, visit_summary, definition):
        for kind in vars(module).values():
            explained = isinstance(kind, type) and issubclass(kind, ExplainedInt | ExplainedStr)
            if explained and kind.__module__ == module.__name__:
                found |= set(kind.meanings().values())
    for names in (state.Reason, readings.Quality, state.VisitPhase, events.EventKind):
        found |= {member.name.lower().replace("_", " ") for member in names}
    return found


def of_the_details() -> set[str]:
    """The sentences of events, faults and alarms, which travel as codes with values; and the words among these."""
    words = {each.value.replace("_", " ") for each in (*AlarmEvent, *AlarmState)} | {"cross check"}
    return {detail.text for detail in sentences.SENTENCES.details if _words(detail.text)} | words


def of_the_alarms() -> set[str]:
    found = {benchmark.title for benchmark in BENCHMARKS} | {NOT_RECORDED}
    alarms: tuple[definition.AlarmDefinition[Any], ...] = (*BAY_ALARMS, *GATEWAY_ALARMS)
    for alarm in alarms:
        found |= {alarm.title, alarm.meaning, alarm.consequence, alarm.action, *alarm.causes}
    return found


def of_the_configuration() -> set[str]:
    """The meanings of the file's keys and tables, as the settings page and the tuning page show them."""

    def described(part: object) -> Iterator[str]:
        if isinstance(part, dict):
            for name in ("description", "x-unit", "x-form"):
                if isinstance(text := part.get(name), str):
                    yield text
            part = list(part.values())
        if isinstance(part, list):
            for each in part:
                yield from described(each)

    schema = settings_model.schema(registry.known_sections(GatewayConfig()))
    keys = parameter_schema.schema()
    found = {*described(schema), *(key.meaning for key in keys), *(key.unit for key in keys)}
    return {text for text in found if _words(text)}


def of_the_remarks() -> set[str]:
    """The gateway's own sentences on the pages: remarks, advice, titles and details of the stages; what follows from a
    teach-in or a calibration, or why nothing does.
    """
    found = {f"{code}: {meaning}" for code, meaning in REJECTIONS.items()}
    found |= {f"the marker is refused: {meaning}" for meaning in REJECTIONS.values()}
    modules = (
        *(remarks, eyedropper, marker_pick, scoring, exposure, thresholds, paper_view, robust_view),
        *(teach_in, teach_ins, solve, collected),
    )
    for module in modules:
        tree = ast.parse(inspect.getsource(module))
        comments = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
        for node in ast.walk(tree):
            if id(node) in comments | parts:
                continue
            if isinstance(node, ast.JoinedStr):
                found |= set(_of_template("".join(_part(part) for part in node.values)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
                found.add(_numbered(node.value))
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Panel":
                found.add(str(ast.literal_eval(node.args[1])))
    return {text for text in found if _words(text)}


def _part(part: ast.expr) -> str:
    if isinstance(part, ast.Constant):
        return str(part.value)
    assert isinstance(part, ast.FormattedValue)
    name = ast.unparse(part.value)
    if "worst_name" in name:
        return "this picture"  # the one name on that page
    return NAME if name in NAMES or name.endswith("quality.meaning") else VALUE


def _of_template(text: str) -> Iterator[str]:
    """What is translated of it: a name at its end, behind a colon, is not; before it, one of those that there are."""
    if text.startswith(NAME):
        yield from (_numbered(name + text.removeprefix(NAME)) for name in ("fx", "fy"))
    else:
        text = text.removesuffix(f": {NAME}")
        assert NAME not in text, text
        yield _numbered(text)


def of_the_report() -> set[str]:
    """Of the answer to *Why?* as a file: elements, captions, an axis, and names of columns and rows."""
    source = Path(page.__file__).read_text(encoding="utf-8")
    texts = re.findall(
        r'<(?:h2|h3|p|span|summary)>([^<{}]+)</|^ {8}"([^"]+)",$|ChartAxis\("([a-z ]+)"', source, re.MULTILINE
    )
    rows = {"time", "decision", "reason", "driver", "outputs", "not recorded what was found in it"}
    return rows.union(*texts) - {""}


def page_texts() -> set[str]:
    """All keys."""
    of_scripts = (texts_of(script) for script in DESK)
    of_tables = (
        of_the_states(),
        of_the_details(),
        of_the_alarms(),
        of_the_configuration(),
        of_the_remarks(),
        of_the_report(),
    )
    return set().union(WORDS, *of_tables, *of_scripts) - NOT_TEXTS


def required_texts() -> set[str]:
    """Keys that each language must have: those of the operator's page and of the login. An alarm that was added last
    may be in English until somebody who speaks the language has translated it.
    """
    scripts: set[Path] = set()
    waiting = list(OPERATOR)
    while waiting:
        script = waiting.pop()
        scripts.add(script)
        imported = re.findall(r"from\s+'(\.[^']+)'", script.read_text(encoding="utf-8"))
        waiting += [path for name in imported if (path := (script.parent / name).resolve()) in {*DESK} - scripts]
    words = WORDS & set().union(*(literals_of(script) for script in scripts))
    return set().union(words, of_the_states(), of_the_details(), *(texts_of(script) for script in scripts)) - NOT_TEXTS


def of_languages() -> dict[str, set[str]]:
    """The keys that each language's file has, by its code; languages of the driver's display alone left out."""
    found = languages({}).catalogues
    return {code: {key for key in one.texts if "|" not in key} for code, one in found.items() if one.pages}


def main() -> None:
    texts, required = page_texts(), required_texts()
    for code, translated in of_languages().items():
        missing, unused = texts - translated, translated - texts
        print(f"{code}.json: {len(missing)} texts missing, shown in English; {len(unused)} that no page shows")
        for text in sorted(missing):
            print(f"  missing{', required' if text in required else ''}: {text}")
        for text in sorted(unused):
            print(f"  not shown: {text}")


if __name__ == "__main__":
    main()
