"""Write the reference pages from the code: commands, scene keys, tables, flags, and the list of public names.

They go to docs/reference/generated before Sphinx looks for its pages; nothing in them is typed by hand.
"""

import ast
import enum
import importlib
import inspect
import itertools
import pkgutil
import re
import textwrap
from pathlib import Path

import click
from pydantic import BaseModel
from sphinx.util import logging

import contactimg
from contactimg import cli, tables
from contactimg.scene import Scene

LOG = logging.getLogger(__name__)
TARGET = Path(__file__).parents[1] / "reference" / "generated"

BOUNDS = {  # of a JSON schema
    "exclusiveMinimum": "above",
    "minimum": "at least",
    "exclusiveMaximum": "below",
    "maximum": "at most",
}
ROOM_TITLES = {  # headings of the Python reference, in its order
    "files": "Reading frames and scenes",
    "scene": "Scene",
    "frame": "Frame",
    "pose": "Pose of the camera, pairs of contacts",
    "imaging": "Measuring an image",
    "pipeline": "Chains: measure, plan, analyse, simulate",
    "forces": "Local forces",
    "surfaces": "Asperities",
    "mechanics": "Closed forms",
    "models": "Contact models",
    "sliding": "Onset of sliding",
    "design": "Designed surfaces",
    "render": "Rendering frames",
    "analysis": "Analysis",
    "shear": "Contacts under a tangential load",
    "calibration": "Calibration",
    "report": "Report",
    "tables": "Flags",
    "errors": "Errors",
}


def setup(app):
    """Write the pages as soon as the configuration is read."""
    app.connect("config-inited", _write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write_pages(_app, _config):
    write("commands.md", command_page())
    write("scene.md", scene_page())
    write("tables.md", table_page())
    write("enums.md", enum_page())
    write("messages.md", message_page())
    write("api.rst", api_page())


def write(name, lines, folder=TARGET):
    """Write a page, unless it is there already with the same text."""
    folder.mkdir(parents=True, exist_ok=True)
    text, path = "\n".join(lines) + "\n", folder / name
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def markdown_table(header, rows):
    """Lines of a table; a bar inside a cell is escaped."""
    lines = [f"| {' | '.join(header)} |", "|" + "---|" * len(header)]
    lines += [f"| {' | '.join(_cell(cell) for cell in row)} |" for row in rows]
    return [*lines, ""]


def _cell(text):
    return " ".join(str(text).split()).replace("|", r"\|")


# --- commands


def command_page():
    """Lines for every command: usage, help, examples, options."""
    lines = []
    for command, name in _commands(cli.commands, "contactimg"):
        context = click.Context(command, info_name=name, show_default=True)
        lines += [f"({name.replace(' ', '-')})=", f"## `{name}`", "", *_prose(command.help)]
        lines += ["```text", command.get_usage(context).removeprefix("Usage: "), "```", ""]
        records = [parameter.get_help_record(context) for parameter in command.get_params(context)]
        rows = [(f"`{names}`", _plain(meaning)) for names, meaning in filter(None, records) if meaning]
        lines += markdown_table(["option", "meaning"], rows)
    return lines


def _commands(command, name):
    """The command and those under it, each with the words that call it."""
    yield command, name
    if isinstance(command, click.Group):
        context = click.Context(command)
        for word in command.list_commands(context):
            yield from _commands(command.get_command(context, word), f"{name} {word}")


def _prose(text):
    r"""Help text as Markdown: paragraphs behind \b stand as they are."""
    lines = []
    for paragraph in inspect.cleandoc(text or "").split("\n\n"):
        if paragraph.startswith("\b"):
            title, *code = paragraph.removeprefix("\b\n").splitlines()
            if title.startswith(" "):
                title, code = "", [title, *code]
            lines += [
                _plain(title),
                "",
                "```text",
                *(inspect.cleandoc("\n".join(["", *code])).splitlines()),
                "```",
                "",
            ]
        else:
            lines += [_plain(paragraph), ""]
    return lines


def _plain(text):
    """Escape what Markdown would read as markup in a sentence of plain text, outside of its code."""
    parts = text.split("`")
    for k in range(0, len(parts), 2):
        part = re.sub(r"([*\[<$])", r"\\\1", parts[k])
        parts[k] = re.sub(r"(?<![\w-])(--[a-z][\w-]*)", r"`\1`", part)
    return "`".join(parts)


# --- scene


def scene_page():
    """Lines for every section and key of the scene file."""
    lines = []
    for section, field in Scene.model_fields.items():
        model = next(kind for kind in _kinds(field.annotation) if issubclass(kind, BaseModel))
        schema = model.model_json_schema(by_alias=True)
        lines += [f"(scene-{section})=", f"## `[{section}]`", "", *_docstring(model), ""]
        rows = []
        required = schema.get("required", ())
        for key, rule in schema["properties"].items():
            if not rule.get("description"):
                LOG.warning("scene key [%s] %s has no description", section, key)
            default = "required" if key in required else _default(rule.get("default"))
            rows.append((f"`{key}`", _rule(rule), default, rule.get("description", "")))
        lines += markdown_table(["key", "value", "default", "meaning"], rows)
    return lines


def _kinds(annotation):
    return [kind for kind in (annotation, *getattr(annotation, "__args__", ())) if inspect.isclass(kind)]


def _docstring(thing):
    """Docstring with double backticks turned into single ones, as Markdown has them."""
    return inspect.cleandoc(thing.__doc__ or "").replace("``", "`").splitlines()


def _default(value):
    if value is None or value == []:
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else repr(value).replace(chr(39), chr(34))}`"


def _rule(rule):
    """What values a key takes, from its JSON schema."""
    if "anyOf" in rule:
        return " or ".join(filter(None, map(_rule, rule["anyOf"])))
    if "enum" in rule or "const" in rule:
        return " or ".join(f'`"{value}"`' for value in rule.get("enum", [rule.get("const")]))
    if "prefixItems" in rule:
        return f"[{', '.join(map(_rule, rule['prefixItems']))}]"
    if rule.get("type") == "array":
        return f"list of {_rule(rule['items'])}"
    names = {"number": "number", "integer": "whole number", "string": "text", "boolean": "`true` or `false`"}
    bounds = {
        "exclusiveMinimum": "above",
        "minimum": "at least",
        "exclusiveMaximum": "below",
        "maximum": "at most",
    }
    limits = " and ".join(f"{word} {rule[name]:g}" for name, word in bounds.items() if name in rule)
    return f"{names.get(rule.get('type'), '')} {limits}".strip()


# --- tables and enumerations


def table_page():
    """Lines for every CSV table and its columns; two tables of one file stand under one heading."""
    lines = []
    by_file = itertools.groupby(sorted(_members(tables.Schema), key=_file_name), key=_file_name)
    for file_name, schemas in by_file:
        lines += [f"(table-{file_name})=", f"## `{file_name}.csv`", ""]
        for schema in schemas:
            lines += _columns(schema)
    return lines


def _file_name(schema):
    return schema.name


def _columns(schema):
    """Lines for the columns of one table."""
    rows = [(f"`{name}`", dtype, _plain(meaning)) for name, (dtype, meaning) in schema.columns.items()]
    lines = [_plain(schema.description), "", *markdown_table(["column", "type", "meaning"], rows)]
    if schema.later:
        names = ", ".join(f"`{name}`" for name in schema.columns if name in schema.later)
        lines += [f"Files of earlier versions lack some of {names}: read back, these are empty.", ""]
    return lines


def enum_page():
    """Lines for every enumeration that the tables hold: flags, and statuses or reasons where they are one."""
    lines = []
    for kind in _enumerations():
        meanings = member_docstrings(kind)
        lines += [f"({kind.__name__.lower()}-members)=", f"### `{kind.__name__}`", "", *_docstring(kind), ""]
        names = [member.name if isinstance(member.value, int) else member.value for member in kind]
        rows = [(f"`{name}`", meanings.get(m.name, "")) for name, m in zip(names, kind, strict=True)]
        lines += markdown_table(["value", "meaning"], rows)
    return lines


def message_page():
    """Lines for every status and flag with cause and cure, and for every warning of the package."""
    lines = []
    for title, kind in (("Statuses", tables.Status), ("Flags", tables.Flag)):
        causes = member_docstrings(kind)
        names = {one: one.name if kind is tables.Flag else one.value for one in kind if one.cure}
        rows = [(f"`{name}`", causes[one.name], _plain(one.cure)) for one, name in names.items()]
        lines += [f"## {title}", "", *markdown_table(["message", "cause", "cure"], rows)]
    rows = sorted({(_plain(text), room) for text, room in _warnings()}, key=lambda row: row[::-1])
    return [*lines, "## Warnings", "", *markdown_table(["warning", "from"], rows)]


def _warnings():
    """Text of each warning in the source, what it names as "...", and the part of the package it is from."""
    package = Path(contactimg.__file__).parent
    for path in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(
                    func=ast.Attribute(value=ast.Name(id="logger"), attr="warning"),
                    args=[ast.Constant(value=str(text)), *_],
                ):
                    named = re.sub(r"%[-+.\d]*[a-z]", "...", text)
                    if re.search(r"\w", named):
                        yield named, path.relative_to(package).parts[0].removesuffix(".py")


def member_docstrings(kind):
    """Member name -> the string that stands under it in the source."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    found = {}
    for node, below in itertools.pairwise(body.body):
        match node, below:
            case ast.Assign(targets=[ast.Name(id=name)]), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = " ".join(text.split()).replace("``", "`")
    return found


def _table_modules():
    yield tables
    for info in pkgutil.iter_modules(getattr(tables, "__path__", ())):
        yield importlib.import_module(f"{tables.__name__}.{info.name}")


def _members(kind):
    """Objects of a type in the modules of the tables, each once."""
    found = {id(value): value for module in _table_modules() for value in vars(module).values()}
    return [value for value in found.values() if isinstance(value, kind)]


def _enumerations():
    return [kind for kind in _members(enum.EnumMeta) if kind.__module__.startswith(tables.__name__)]


# --- Python


def api_page():
    """A reStructuredText page with a table of the public names of every room."""
    rooms = public_names()
    lines = ["Python", "======", "", "Every name below is imported from ``contactimg``.", ""]
    for room in [*ROOM_TITLES, *sorted(set(rooms) - set(ROOM_TITLES))]:
        names = rooms.get(room, [])
        modules = [name for name in names if inspect.ismodule(getattr(contactimg, name))]
        title = ROOM_TITLES.get(room, room)
        lines += [title, "-" * len(title), ""] if names else []
        if len(names) > len(modules):
            lines += [".. currentmodule:: contactimg", ".. autosummary::", "   :toctree: api", ""]
            lines += [f"   {name}" for name in names if name not in modules] + [""]
        if modules:
            lines += [".. toctree::", "   :maxdepth: 1", "", *(f"   api/{name}" for name in modules), ""]
    return lines


def public_names():
    """Room -> names that ``contactimg`` exports from it, as the stub lists them."""
    stub = ast.parse(Path(contactimg.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    rooms = {}
    for node in stub.body:
        if isinstance(node, ast.ImportFrom):
            rooms.setdefault(str(node.module).split(".")[0], []).extend(alias.asname for alias in node.names)
    for name in (name for names in rooms.values() for name in names):
        thing = getattr(contactimg, name)
        if inspect.ismodule(thing):
            page = [name, "=" * len(name), "", f".. automodule:: {thing.__name__}", "   :members:"]
            write(f"{name}.rst", page, TARGET / "api")
    return rooms
