"""Commands from annotated parameters and option dataclasses."""

import math
from dataclasses import dataclass, fields
from typing import Annotated, Literal

import pytest
import typer
from typer.testing import CliRunner

from sysid.cli.adapter import command
from sysid.landing.impulse import ImpulseSettings
from sysid.landing.outcomes import Rules
from sysid.workflows.options import Argument, Flag, ImpulseOptions, RulesOptions


@dataclass(frozen=True)
class Group:
    kind: Annotated[Literal["a", "b"], Flag("Kind.")] = "a"
    turn: Annotated[float, Flag("Turn [deg].", "--turn-deg", read=math.radians, default="90")] = math.pi / 2
    python_only: int = 3


@pytest.fixture
def parse():
    """Return what a command of one argument, flags and a group of options gets from a command line."""
    app, received = typer.Typer(rich_markup_mode=None), []

    @command(app, "go")
    def go(
        names: Annotated[tuple[str, ...], Argument("Names.")],
        options: Group,
        many: Annotated[tuple[float, ...], Flag("Numbers.", default="1 and 2")] = (1.0, 2.0),
        least: Annotated[int | None, Flag("Count.", least=2)] = None,
    ) -> int:
        """Go."""
        received.append((names, options, many, least))
        return 7

    def call(*arguments):
        result = CliRunner().invoke(app, arguments)
        return result, received[-1] if received else None

    return call


def test_values_and_defaults_reach_the_function(parse):
    result, values = parse("x", "y")
    assert result.exit_code == 7
    assert values == (("x", "y"), Group(), (1.0, 2.0), None)
    _, values = parse("x", "--kind", "b", "--turn-deg", "180", "--many", "3", "--many", "4", "--least", "2")
    assert values == (("x",), Group("b", math.pi), (3.0, 4.0), 2)


def test_wrong_values_are_refused_and_help_shows_defaults(parse):
    for wrong in (("x", "--kind", "c"), ("x", "--least", "1"), (), ("x", "--python-only", "3")):
        assert parse(*wrong)[0].exit_code == 2
    text = parse("--help")[0].output
    for words in ("Go.", "[default: 90", "1 and 2", "--kind"):
        assert words in text
    assert "python" not in text


@pytest.mark.parametrize(("options", "domain"), [(RulesOptions, Rules), (ImpulseOptions, ImpulseSettings)])
def test_options_have_the_defaults_of_the_landing(options, domain):
    shared = {f.name for f in fields(options)} - {"rear"}  # the command derives it
    assert shared <= {f.name for f in fields(domain)}
    for name in shared:
        assert getattr(options(), name) == getattr(domain(), name)
