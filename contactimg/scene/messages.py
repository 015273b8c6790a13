"""One sentence for each way in which a scene can break a rule."""

import difflib

from pydantic_core import ErrorDetails

from contactimg.scene.rules import Section


def broken_rule(detail: ErrorDetails, name: str, root: type[Section]) -> str:
    """One sentence for one validation error.

    Parameters
    ----------
    detail : ErrorDetails
        From pydantic.
    name : str
        What to call the scene (the file name).
    root : type
        The model of the whole scene, which knows the allowed sections and keys.
    """
    section, *keys = detail["loc"]
    if detail["type"] == "extra_forbidden":
        return _unknown_key(name, str(section), str(keys[0]) if keys else None, root)
    where = f"{name}: [{section}]" + "".join(_place(key) for key in keys)
    if detail["type"] == "missing":
        return f"{where} is missing; add it"
    if detail["type"] == "value_error":
        return f"{where}{'' if keys else ':'} {detail['msg'].removeprefix('Value error, ')}"
    return f"{where} {_rule(detail)}, got {detail['input']!r}"


def _place(key: int | str) -> str:
    """A key, or a position in a list."""
    return f"[{key}]" if isinstance(key, int) else f" {key}"


def _rule(detail: ErrorDetails) -> str:
    """The broken rule in plain words."""
    context = detail.get("ctx", {})
    rules = {
        "model_type": "must be a section of keys",
        "bool_type": "must be true or false",
        "float_type": "must be a number",
        "int_type": "must be a whole number",
        "string_type": "must be text in quotes",
        "string_too_short": "must not be empty",
        "list_type": "must be a list",
        "tuple_type": "must be a list",
        "too_long": f"must have no more than {context.get('max_length')} items",
    }
    return rules.get(detail["type"], detail["msg"].replace("Input should", "must", 1))


def _unknown_key(name: str, section: str, key: str | None, root: type[Section]) -> str:
    """The sentence for a key or section that does not exist, with the allowed ones."""
    if key is None:
        allowed, what = _keys(root), f"{name}: unknown section [{section}]"
        wrong, kind = section, "sections"
    else:
        annotation = root.model_fields[section].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next(o for o in options if isinstance(o, type) and issubclass(o, Section))
        allowed, what = _keys(model), f"{name}: [{section}] has no key {key!r}"
        wrong, kind = key, "keys"
    close = difflib.get_close_matches(wrong, allowed, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"{what}{hint} (allowed {kind}: {', '.join(allowed)})"


def _keys(model: type[Section]) -> list[str]:
    """Names of a section's keys as written in the scene file."""
    return [field.alias or attribute for attribute, field in model.model_fields.items()]
