"""Documents: JSON files whose content is declared, so that reading one is checking it.

A document is a frozen pydantic model with a schema name and a version. A declared number that JSON lacks is
written as ``"NaN"``, ``"Infinity"`` or ``"-Infinity"``, and every float is read back bit for bit. Content
that only the writer understands (the settings of a model) is an `Open` field, see `sysid.exact_json`.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import ErrorDetails, core_schema

from sysid import exact_json
from sysid.errors import SysidError


def _opened(value: object, info: ValidationInfo) -> object:
    return exact_json.decoded(value) if info.mode == "json" else exact_json.plain(value)


# Fields of any JSON content; floats survive inside them, and arrays become lists.
Open = Annotated[
    Any, BeforeValidator(_opened), PlainSerializer(exact_json.encoded, return_type=Any, when_used="json")
]
OpenMapping = Annotated[
    dict[str, Any],
    BeforeValidator(_opened),
    PlainSerializer(exact_json.encoded, return_type=dict[str, Any], when_used="json"),
]

# Units of the quantities in open fields, by key. A key that ends in _deg states its unit.
UNITS = {
    key: unit
    for unit, keys in {
        "Hz": "rate cutoff cutoff_3db stop_edge transition",
        "s": "release touchdown window doubtful starts_from_rest offset before_contact after_contact delay "
        "own_delay measured simulated time time_to_rest trigger time_limit wall_time",
        "m": "distance x z down_slope down_slope_error up up_error",
        "m/s": "impact_speed",
        "m/s²": "gravity gravity_error measured_gravity",
        "rad": "pitch",
        "kg·m²": "inertia standard_error",
    }.items()
    for key in keys.split()
}
_SYMBOLS = {"x_B_rate": "ẋ_B", "z_B_rate": "ż_B", "stator_torque": "stator torque"}


def label(key: str) -> str:
    """Return a key of a document as people read it: ``time to rest [s]``."""
    name = key.removesuffix("_deg")
    unit = UNITS.get(key, "") if name == key else "deg"
    return name.replace("_", " ") + (f" [{unit}]" if unit else "")


def channel_symbol(channel: str) -> str:
    """Return what tables call a compared channel: ``ẋ_B`` for ``x_B_rate``."""
    return _SYMBOLS.get(channel, channel)


CONFIG = ConfigDict(
    # A command builds the validators of the documents that it reads, not of all that it imports.
    defer_build=True,
    frozen=True,
    extra="forbid",
    ser_json_inf_nan="strings",
    validate_by_name=True,
    validate_by_alias=True,
    serialize_by_alias=True,
)


def rounded(value: float, digits: int = 4) -> str:
    """Return a number with `digits` digits; an exponent only below 1e-4 and from 1e7 on."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e7 else text


def interval(ends: Iterable[float], opened: Iterable[bool]) -> str:
    """Return an interval as text; an end that the data leave open is not printed."""
    (low, high), (below, above) = map(rounded, ends), opened
    if below and above:
        return "open"
    return f"≤ {high}" if below else f"≥ {low}" if above else f"{low} to {high}"


class Part(BaseModel):
    """A part of a document; unknown keys are refused, arrays are taken as lists."""

    model_config = CONFIG

    @model_validator(mode="before")
    @classmethod
    def _take_arrays(cls, values: object) -> object:
        if not isinstance(values, dict):
            return values
        return {k: v.tolist() if isinstance(v, np.ndarray | np.generic) else v for k, v in values.items()}

    @classmethod
    def json_schema(cls) -> JsonSchemaValue:
        """Return the JSON Schema; its comment states the units of `UNITS`."""
        listed = ", ".join(f"{key} [{unit}]" for key, unit in UNITS.items())
        units = f"Units of keys in open fields: {listed}; keys that end in _deg: degrees."
        schema = cls.model_json_schema(by_alias=True, schema_generator=_Schema, mode="serialization")
        return {"$comment": units} | schema


class _Schema(GenerateJsonSchema):
    def float_schema(self, schema: core_schema.FloatSchema) -> JsonSchemaValue:
        return {"anyOf": [super().float_schema(schema), {"enum": ["NaN", "Infinity", "-Infinity"]}]}


FileName = Annotated[str, Field(pattern=r"^[^/\\\x00]+$")]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Document(Part):
    """A document that is a JSON file.

    A kind of document declares ``schema_`` (key ``schema``) and ``version`` as literals with defaults. A
    refusal calls it `WHAT` and advises the `REMEDY`. `MIGRATIONS` has, by an older version, the function that
    turns the content of that version into the next one's, so that old files stay readable.
    """

    WHAT: ClassVar[str] = "a document"
    REMEDY: ClassVar[str] = "write it again"
    MIGRATIONS: ClassVar[Mapping[int, Callable[[dict[str, Any]], dict[str, Any]]]] = {}

    schema_: str = Field(alias="schema")
    version: int
    # SHA-256 of the document's own text (without that SHA-256) and of the files it belongs to, by file name.
    sha256: dict[FileName, Sha256] = Field(default_factory=dict, exclude=True)

    def sealed(self, name: str, **others: str) -> bytes:
        """Return the content of the file `name`, with its SHA-256 and that of `others` by name."""
        text = f'{{\n  "sha256": {json.dumps({**others, name: ""})},{self.text()[1:]}'
        return text.replace('""', f'"{hashlib.sha256(text.encode("utf-8")).hexdigest()}"', 1).encode("utf-8")

    def changed(self, path: Path, content: bytes) -> str | None:
        """Return the name of a file in the folder of `path` whose SHA-256 is another than stated here.

        `content` is the document's own file, which comes first; None where nothing has changed.
        """
        for name, digest in sorted(self.sha256.items(), key=lambda item: item[0] != path.name):
            file, data = path.with_name(name), content.replace(digest.encode("ascii"), b"", 1)
            if name != path.name:
                data = file.read_bytes() if file.is_file() else b""
            if hashlib.sha256(data).hexdigest() != digest:
                return name
        return None

    def text(self) -> str:
        """Return the file's text."""
        return self.model_dump_json(indent=2) + "\n"

    def line(self) -> str:
        """Return the text without line breaks, to be kept in another file."""
        return self.model_dump_json()

    @classmethod
    def parse(cls, text: str | bytes, place: object, error_type: type[SysidError] = SysidError) -> Self:
        """Return the document in a JSON text that lies at `place`.

        Raises `error_type` when the text is foreign, of another version, damaged or cut off.
        """
        try:
            head = json.loads(text)
        # Lists in lists without end are a RecursionError.
        except (ValueError, RecursionError) as error:
            raise error_type(f"{place}: damaged or cut off ({error}); {cls.REMEDY}") from error
        return cls._checked(head, place, error_type, lambda: cls.model_validate_json(text))

    @classmethod
    def of(cls, content: object, place: object, error_type: type[SysidError] = SysidError) -> Self:
        """Return the document of a content that is no JSON text; other arguments as for `parse`."""
        return cls._checked(content, place, error_type, lambda: cls.model_validate(content))

    @classmethod
    def _checked(
        cls, content: object, place: object, error_type: type[SysidError], validated: Callable[[], Self]
    ) -> Self:
        name, number = (cls.model_fields[field].default for field in ("schema_", "version"))
        head = content if isinstance(content, dict) else {}
        if head.get("schema") != name or not isinstance(head.get("version"), int | None):
            raise error_type(f"{place}: not {cls.WHAT} of sysid; {cls.REMEDY}")
        old = head.get("version")
        while head.get("version") in cls.MIGRATIONS:
            version = head["version"]
            head = cls.MIGRATIONS[version](head) | {"version": version + 1}
        if head.get("version") != number:
            raise error_type(
                f"{place}: {cls.WHAT} of version {old!r}, expected {number}; read it with "
                f"the version of sysid that wrote it, or {cls.REMEDY}"
            )
        try:
            # JSON again, because its rules for numbers that JSON lacks are others than Python's.
            return validated() if head.get("version") == old else cls.model_validate_json(json.dumps(head))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(key) for key in first["loc"])
            refusal = f"{place}: damaged or cut off ({where}: {mistake(first)}); {cls.REMEDY}"
            raise error_type(refusal) from error


# Sentences of refusals by the beginning of the type of mistake that pydantic states.
_MISTAKES = {
    "int_": "expected a whole number", "float_": "expected a number",
    "finite_number": "expected a finite number",
    "string_type": "expected text in quotes", "string_too_short": "expected text that is not empty",
    "string_too_long": "expected at most {max_length} characters",
    "string_pattern": "expected letters, digits, dots, hyphens and underscores, as in drop-1.a",
    "bool_": "expected true or false", "literal_error": "expected {expected}",
    "greater_than_equal": "expected at least {ge:g}", "greater_than": "expected more than {gt:g}",
    "less_than_equal": "expected at most {le:g}", "less_than": "expected less than {lt:g}",
    "too_long": "expected at most {max_length} values", "too_short": "expected at least {min_length} values",
    "tuple_type": "expected a list", "list_type": "expected a list", "dict_type": "expected a table",
    "model_": "expected a table", "missing": "it is missing", "extra_forbidden": "it is unknown",
    "unexpected_positional": "expected fewer values", "is_instance_of": "expected a {class}",
}  # fmt: skip


def mistake(detail: ErrorDetails) -> str:
    """Return what one of the errors of a `ValidationError` says, in words."""
    kind, context = detail["type"], detail.get("ctx", {})
    if kind in ("value_error", "assertion_error"):
        return str(context["error"])
    near = next((words for begin, words in _MISTAKES.items() if kind.startswith(begin)), detail["msg"])
    return near.format(**context)
