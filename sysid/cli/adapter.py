"""Turns functions of annotated parameters and option dataclasses into commands of typer.

What a parameter is called, means and refuses stands in `sysid.workflows.options`, once; typer is known in
`sysid.cli` only.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum, StrEnum
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import typer

from sysid.interrupt import heard_interrupts
from sysid.workflows.options import Argument, Flag

Run = Callable[..., int | None]


def command(app: typer.Typer, name: str) -> Callable[[Run], Run]:
    """Return a decorator that makes a function a command of `app`.

    The function's docstring is the help of the command; an integer that it returns is the exit code.
    """

    def register(run: Run) -> Run:
        hints = get_type_hints(run, include_extras=True)
        defaults = {p.name: p.default for p in inspect.signature(run).parameters.values()}
        parts = [(key, hints[key], defaults[key]) for key in defaults]

        def call(**given: Any) -> None:
            try:
                with heard_interrupts():
                    code = run(**_values(parts, given))
            except KeyboardInterrupt:
                # typer would end without a word.
                typer.echo("stopped by the user", err=True)
                code = 130
            if code:
                raise typer.Exit(code)

        call.__doc__ = run.__doc__
        parameters = list(_parameters(parts))
        call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        call.__annotations__ = {p.name: p.annotation for p in parameters}
        app.command(name)(call)
        return run

    return register


def _parts(cls: type) -> list[tuple[str, Any, Any]]:
    """Return name, annotation and default of every field of an options dataclass."""
    hints, empty = get_type_hints(cls, include_extras=True), inspect.Parameter.empty
    return [(f.name, hints[f.name], empty if f.default is MISSING else f.default) for f in fields(cls)]


def _parameters(parts: list[tuple[str, Any, Any]]) -> Iterator[inspect.Parameter]:
    """Yield typer's parameters; nested dataclasses contribute theirs in their place."""
    for name, hint, default in parts:
        if is_dataclass(hint):
            assert isinstance(hint, type)
            yield from _parameters(_parts(hint))
            continue
        mark = _mark(hint)
        if mark is None:
            continue
        kind, values = _kind(get_args(hint)[0])
        required = default is inspect.Parameter.empty
        info: Any
        shown: bool | str = not required
        if isinstance(mark, Argument):
            info = typer.Argument(help=mark.help, show_default=shown)
        else:
            if mark.read is not None:
                kind, values = mark.given, False
                default = default if required else mark.given(mark.default) if mark.default else None
            elif mark.default or values:
                # What the user does not give keeps the default of the dataclass or function, see `_values`.
                default, shown = (default if required else None), mark.default or False
            flags = mark.names or (f"--{name.replace('_', '-')}",)
            info = typer.Option(*flags, help=mark.help, min=mark.least, show_default=shown)
        kind = list[kind] if values else kind  # type: ignore[valid-type]
        annotation = Annotated[kind | None if default is None else kind, info]  # type: ignore[valid-type]
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _values(parts: list[tuple[str, Any, Any]], given: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a function or dataclass from what typer parsed."""
    out = {}
    for name, hint, _ in parts:
        if is_dataclass(hint):
            assert isinstance(hint, type)
            out[name] = hint(**_values(_parts(hint), given))
        elif given.get(name) is not None:
            value, mark = given[name], _mark(hint)
            if isinstance(mark, Flag) and mark.read is not None:
                value = mark.read(value)
            elif isinstance(value, Enum):
                value = value.value
            elif isinstance(value, list):
                value = tuple(value)
            out[name] = value
    return out


def _mark(hint: Any) -> Argument | Flag | None:
    """Return the place on the command line that an annotation states."""
    marks = (mark for mark in get_args(hint)[1:] if isinstance(mark, (Argument, Flag)))
    return next(marks, None) if get_origin(hint) is Annotated else None


def _kind(hint: Any) -> tuple[Any, bool]:
    """Return the type of one value, as typer understands it, and whether the user may give several."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (member for member in get_args(hint) if member is not NoneType)
    if get_origin(hint) is tuple:
        return get_args(hint)[0], True
    if get_origin(hint) is Literal:
        return StrEnum("Choice", {word: word for word in get_args(hint)}), False
    return hint, False
