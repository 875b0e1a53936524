"""Turns functions of annotated parameters and option dataclasses into commands of typer.

`sysid.marks` says once what a parameter is called, means and refuses; typer is known in
`sysid.cli` only.
"""

import inspect
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, redirect_stdout
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum, StrEnum
from functools import cached_property
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand

from sysid.interrupt import heard_interrupts
from sysid.marks import MORE, RARE, Argument, Flag, field_hints, field_values, mark_of
from sysid.plugin import NAMED, run_file
from sysid.workflows.options import Quiet

Run = Callable[..., int | None]


_LAST, _DEFAULT = ("Output", "Computing", MORE), re.compile(r"\[default: \(([^)]*)\)")
# Words of the help for a value by its type; a choice lists its own.
_VALUES = {Path: "PATH", str: "TEXT", int: "NUMBER", float: "NUMBER"}
# An example that is longer goes on in the next line [characters].
_LINE = 74
# A command with more options shows them under the headings that their declarations name.
_MANY = 8
# Largest number of options in a help; the rare ones of a longer list stand in `--help-all`.
_MOST = 12
_ALL = "--help-all"


class Command(TyperCommand):
    """A command whose help shows many options under headings, as plain text."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the command line; typer calls this. A refusal loses the prefix of pydantic."""
        ctx.meta[_ALL] = _ALL in args
        try:
            return super().parse_args(ctx, ["--help"] if _ALL in args else args)
        except typer.BadParameter as error:
            error.message = error.message.removeprefix("Value error, ")
            raise

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options; typer calls this."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        every = self.get_params(ctx)
        options = [param for param in every if param.param_type_name == "option"]
        rare: list[Any] = []
        if len(options) > _MOST and not ctx.meta.get(_ALL):
            rare = [param for param in options if getattr(param, "rich_help_panel", None) in RARE]
        several = len(options) > _MANY
        for param in every:
            if param in rare:
                continue
            group = "Arguments" if param not in options else "Options"
            panel: str | None = getattr(param, "rich_help_panel", None)
            if several and panel:
                group = panel
            if record := param.get_help_record(ctx):
                groups.setdefault(group, []).append(record)
        for group in sorted(groups, key=lambda name: _LAST.index(name) if name in _LAST else -1):
            if rows := groups[group]:
                with formatter.section(group):
                    # click puts brackets around a default that is a text.
                    formatter.write_dl([(name, _DEFAULT.sub(r"[default: \1", help)) for name, help in rows])
        if rare:
            with formatter.section(f"{len(rare)} more, which {_ALL} explains"):
                names = ", ".join(max(param.opts, key=len) for param in rare)
                lines = textwrap.wrap(names, formatter.width - 2, break_on_hyphens=False)
                formatter.write("".join(f"  {line}\n" for line in lines))


def command(app: typer.Typer, name: str, example: str, alias: str = "") -> Callable[[Run], Run]:
    """Return a decorator that makes a function a command of `app`.

    The function's docstring is the help of the command, and its first line what lists of commands say; an
    integer that it returns is the exit code. The help ends with an `example`, which runs after the demo. An
    `alias` is a former name, which no list of commands has.
    """

    def register(run: Run) -> Run:
        epilog = f"\b\nExample:\n  {_folded(example)}"
        for one in filter(None, (name, alias)):
            app.command(one, cls=Command, epilog=epilog, hidden=one == alias)(_Callback(run, name))
        return run

    return register


class _Callback:
    """A function as typer calls it; its options are worked out when typer asks for them."""

    def __init__(self, run: Run, name: str) -> None:
        self.run, self.__name__, self.__doc__ = run, name, run.__doc__
        self.__annotations__: dict[str, object] = {}

    @cached_property
    def __signature__(self) -> inspect.Signature:
        hints = get_type_hints(self.run, include_extras=True)
        defaults = {p.name: p.default for p in inspect.signature(self.run).parameters.values()}
        hints.pop("return")
        # Every command has the option; what is printed is silenced here, and a command asks for its progress.
        self.asks = any(one.name == "quiet" for one in _parameters(hints, defaults))
        if not self.asks:
            hints["quiet"], defaults["quiet"] = Quiet, False
        self.hints = hints
        option = typer.Option(
            "--plugin", help="Python file with a model of your own.", metavar="FILE.py",
            rich_help_panel=None if self.__name__ == "fit" else MORE,
        )  # fmt: skip
        plugin = inspect.Parameter(
            "plugin", inspect.Parameter.KEYWORD_ONLY, default=None,
            annotation=Annotated[list[Path] | None, option],
        )  # fmt: skip
        return inspect.Signature([*_parameters(hints, defaults), plugin])

    def __call__(self, plugin: list[Path] | None = None, **given: object) -> None:
        NAMED[:] = plugin or ()
        for file in NAMED:
            run_file(file, "that calls sysid.model")
        # An option that the user leaves out keeps the default of the dataclass or function.
        stated = {name: value for name, value in given.items() if value is not None}
        values = field_values(self.hints, stated, _value)
        mute = stated.get("quiet") and not stated.get("json")
        if not self.asks:
            values.pop("quiet", None)
        try:
            with heard_interrupts(), redirect_stdout(None) if mute else nullcontext():
                code = self.run(**values)
        except (KeyboardInterrupt, RuntimeError) as error:
            # Python 3.11 hands on an interrupt in the making of a class as the cause of another error.
            if not any(isinstance(one, KeyboardInterrupt) for one in (error, error.__cause__)):
                raise
            # typer would end without a word.
            typer.echo("stopped by the user", err=True)
            code = 130
        if code:
            raise typer.Exit(code)


def _folded(example: str) -> str:
    """Return a command in lines that a shell joins again."""
    lines = [""]
    for part in re.split(r" (?=--)", example):
        if lines[-1] and len(lines[-1]) + len(part) > _LINE:
            lines.append(f"  {part}")
        else:
            lines[-1] = f"{lines[-1]} {part}".strip() if len(lines) == 1 else f"{lines[-1]} {part}"
    return " \\\n  ".join(lines)


def _parameters(
    hints: Mapping[str, object], defaults: Mapping[str, Any], panel: str = ""
) -> Iterator[inspect.Parameter]:
    """Yield typer's parameters; nested dataclasses contribute theirs in their place, under their heading."""
    for name, hint in hints.items():
        if is_dataclass(hint):
            inner = {f.name: f.default for f in fields(hint) if f.default is not MISSING}
            yield from _parameters(field_hints(hint), inner, getattr(hint, "panel", ""))
            continue
        mark = mark_of(hint)
        default = defaults.get(name, inspect.Parameter.empty)
        required = default is inspect.Parameter.empty
        kind, values = _kind(get_args(hint)[0])
        info: object
        if isinstance(mark, Argument):
            metavar = "|".join(kind) if issubclass(kind, StrEnum) else name.upper()
            info = typer.Argument(help=mark.help, show_default=not required, metavar=metavar)
        else:
            assert isinstance(mark, Flag)
            shown: bool | str = not required
            help = mark.help
            if mark.read is not None or mark.unit:
                kind, values = (Path if kind is Path else str), values and not mark.read
            shown_as = "QUANTITY" if mark.unit else _VALUES.get(kind)
            if mark.unit:
                # Behind the first sentence.
                help = re.sub(r"\.(?= |$)", f" [{mark.unit}].", help, count=1)
            if mark.read or mark.unit or mark.default or values:
                shown = mark.default or (
                    mark.shown(default) if mark.unit and not required and default is not None else False
                )
                default = default if required else None
            least = None if mark.unit else mark.least
            info = typer.Option(
                *mark.spelled(name), help=help, min=least, max=mark.most, show_default=shown,
                metavar=shown_as,
                rich_help_panel=mark.panel or panel or None,
            )  # fmt: skip
        kind = list[kind] if values else kind  # type: ignore[valid-type]
        annotation = Annotated[kind | None if default is None else kind, info]  # type: ignore[valid-type]
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _value(name: str, value: Any, hint: object) -> object:
    """Return the value of a field from what typer parsed."""
    mark = mark_of(hint)
    if isinstance(value, Enum):
        value = value.value
    elif isinstance(value, list):
        value = tuple(value)
    if isinstance(mark, Argument):
        return value if mark.read is None else mark.read(value)
    if mark is None or not (mark.read or mark.unit):
        return value
    option = mark.spelled(name)[0]
    if mark.read is not None:
        return mark.read(value, option)
    if isinstance(value, tuple):
        return tuple(mark.quantity(one, option) for one in value)
    return mark.quantity(value, option)


def _kind(hint: Any) -> tuple[type, bool]:
    """Return the type of one value, as typer understands it, and whether the user may give several."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (member for member in get_args(hint) if member is not NoneType)
    if get_origin(hint) is tuple:
        return get_args(hint)[0], True
    if get_origin(hint) is Literal:
        words: tuple[str, ...] = get_args(hint)
        return StrEnum("Choice", dict(zip(words, words, strict=True))), False  # type: ignore[return-value]
    return hint, False
