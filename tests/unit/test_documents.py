"""Documents: floats survive bit for bit, and what is foreign, old or cut off is refused in one sentence."""

import json
import math
import struct
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from sysid.documents import Document, OpenMapping, Part
from sysid.errors import FitError
from sysid.workflows.schema import DOCUMENTS, print_schema


class Row(Part):
    name: str
    sigma: float | None = None


class Note(Document):
    WHAT = "a note"
    REMEDY = "run sysid note again"
    schema_: Literal["sysid-note"] = Field("sysid-note", alias="schema")
    version: Literal[2] = 2
    values: tuple[float, ...]
    rows: tuple[Row, ...] = ()
    settings: OpenMapping = Field(default_factory=dict)


def bits(value):
    return struct.pack("<d", value if value == value else math.nan)


@given(st.lists(st.floats(), max_size=5))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_floats_come_back_bit_for_bit(values):
    note = Note(values=np.array(values), rows=[Row(name="NaN", sigma=math.nan)], settings={"a": [values]})
    back = Note.parse(note.text(), "note.json")
    assert [bits(v) for v in back.values] == [bits(v) for v in values]
    assert [bits(v) for v in back.settings["a"][0]] == [bits(v) for v in values]
    assert back.rows[0].name == "NaN"
    assert math.isnan(back.rows[0].sigma)
    assert back.text() == note.text()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"schema": "other"}', "not a note of sysid; run sysid note again"),
        ("[1]", "not a note of sysid"),
        ('{"schema": "sysid-note", "version": 1}', "version 1, expected 2"),
        ('{"schema": "sysid-note", "version": [[1]]}', "not a note of sysid"),
        ('{"schema": "sysid-note", "version": 2, "val', "damaged or cut off"),
        ("[" * 100_000, "damaged or cut off .*recursion"),
        ('{"schema": "sysid-note", "version": ' + "9" * 5000 + "}", "damaged or cut off .*digits"),
        ('{"schema": "sysid-note", "version": 2}', r"damaged .*values: it is missing"),
        ('{"schema": "sysid-note", "version": 2, "values": [], "colour": 1}', "damaged .*colour"),
        ('{"schema": "sysid-note", "version": 2, "values": [], "rows": [{}]}', r"damaged .*rows\.0\.name"),
    ],
)
def test_refusals(text, words):
    with pytest.raises(FitError, match=f"^note.json: .*{words}") as refusal:
        Note.parse(text, "note.json", FitError)
    assert "\n" not in str(refusal.value)


class Letter(Document):
    WHAT = "a letter"
    MIGRATIONS = {  # noqa: RUF012
        1: lambda old: {"schema": old["schema"], "words": old["said"]},
        2: lambda old: old | {"weight": "NaN"},
    }
    schema_: Literal["sysid-letter"] = Field("sysid-letter", alias="schema")
    version: Literal[3] = 3
    words: str
    weight: float


def test_an_older_document_is_read_by_one_function_for_each_version():
    first = Letter.parse('{"schema": "sysid-letter", "version": 1, "said": "hello"}', "letter.json")
    assert (first.version, first.words) == (3, "hello")
    assert math.isnan(first.weight)
    second = Letter.parse('{"schema": "sysid-letter", "version": 2, "words": "hello"}', "letter.json")
    assert second.words == first.words
    with pytest.raises(FitError, match="of version 4, expected 3; read it with the version of sysid that"):
        Letter.parse('{"schema": "sysid-letter", "version": 4}', "letter.json", FitError)
    with pytest.raises(FitError, match="damaged or cut off"):
        Letter.parse('{"schema": "sysid-letter", "version": 2}', "letter.json", FitError)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_schemas_are_printed(name, capsys):
    print_schema(name)
    schema = json.loads(capsys.readouterr().out)
    # A check is printed, not kept: it has no schema name.
    assert name == "check" or {"schema", "version"} <= {*schema["properties"]}
    assert schema["additionalProperties"] is False
    with pytest.raises(Exception, match=f"unknown document 'x'; expected one of .*{name}"):
        print_schema("x")
