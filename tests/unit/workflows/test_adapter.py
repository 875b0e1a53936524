"""Commands from annotated parameters and option dataclasses."""

import math
import re
from dataclasses import dataclass
from typing import Annotated, Literal

import pytest
import typer
from typer.testing import CliRunner

import sysid
from fakes.places import SAMPLES
from sysid.cli import app
from sysid.cli.adapter import command
from sysid.cli.root import EXIT_CODES, GROUPS
from sysid.errors import CampaignError, LogError, SysidWarning, UnitError
from sysid.landing.outcomes import Rules
from sysid.landing.settings import ImpulseSettings, MapSettings, StudySettings
from sysid.marks import Argument, Flag, field_hints, mark_of, span
from sysid.workflows.options import campaign_file, log_files


@dataclass(frozen=True)
class Group:
    kind: Annotated[Literal["a", "b"], Flag("Kind.")] = "a"
    turn: Annotated[float, Flag("Turn.", unit="deg", least=0)] = math.pi / 2
    python_only: int = 3


@pytest.fixture
def parse():
    """Return what a command of one argument, flags and a group of options gets from a command line."""
    app, received = typer.Typer(rich_markup_mode=None), []

    @command(app, "go", "sysid go")
    def go(
        names: Annotated[tuple[str, ...], Argument("Names.")],
        options: Group,
        many: Annotated[tuple[float, ...], Flag("Forces.", unit="N", default="1 and 2")] = (1.0, 2.0),
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
    _, values = parse("x", "--kind", "b", "--turn", "180 deg", "--many", "3", "--many", "4", "--least", "2")
    assert values == (("x",), Group("b", math.pi), (3.0, 4.0), 2)


def test_wrong_values_are_refused_and_help_shows_defaults(parse):
    for wrong in (("x", "--kind", "c"), ("x", "--least", "1"), (), ("x", "--python-only", "3")):
        assert parse(*wrong)[0].exit_code == 2
    text = parse("--help")[0].output
    for words in ("Go.", "Turn [deg].", "[default: 90 deg]", "[default: 1 and 2]", "--kind", "sysid go"):
        assert words in text
    assert "python" not in text


def test_quantities_carry_units_and_bare_numbers_keep_theirs(parse):
    for text in ("90 deg", "90deg", f"{math.pi / 2!r} rad"):
        assert parse("x", "--turn", text)[1][1].turn == pytest.approx(math.pi / 2, rel=1e-15)
    assert parse("x", "--many", "3 mN", "--many", "4")[1][2] == (0.003, 4.0)
    refusals = {
        "3 m": "unit 'm' is not a 'deg'", "fast": "--turn: 'fast' is not a number", "nan": "finite",
        "-1 deg": "--turn -1 deg: expected 0 deg or more",
        # Python's bare angles are in rad, so a command takes none.
        "20": "--turn: '20' has no unit; expected for example '20 deg'",
    }  # fmt: skip
    for text, words in refusals.items():
        refusal = parse("x", "--turn", text)[0].exception
        assert isinstance(refusal, UnitError), text
        assert words in str(refusal)


@pytest.mark.parametrize(
    ("text", "unit", "values"),
    [
        ("0:45:15deg", "deg", (0, 15, 30, 45)),
        ("0:45:15 deg", "deg", (0, 15, 30, 45)),
        ("0 deg, 1 rad", "deg", (0, 57.295779513)),
        ("0:100:50 ms", "s", (0, 0.05, 0.1)),
        ("0.3,0.6 m/s", "m/s", (0.3, 0.6)),
        # A span ends at or before its last number.
        ("0:2:0.3", "1", (0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8)),
        ("0:0.3:0.1", "1", (0, 0.1, 0.2, 0.3)),
        ("0:2:0.05", "1", tuple(round(0.05 * k, 2) for k in range(41))),
        ("0:0.26:0.01", "1", tuple(round(0.01 * k, 2) for k in range(27))),
        ("0:45:1", "1", tuple(range(46))),
        ("1:1:2", "1", (1,)),
    ],
)
def test_grids_carry_units(text, unit, values):
    assert span(text, "--slopes", unit) == values


def test_an_angle_needs_its_unit_in_a_grid_and_in_python_too():
    for text in ("0:45:15", "10,20", "10, 20 deg, 30"):
        with pytest.raises(CampaignError, match=f"--slopes '{text}': an angle has no unit; expected for "):
            span(text, "--slopes", "deg")
    with pytest.raises(UnitError, match="slope: '20' has no unit; expected for example '20 deg'"):
        sysid.simulate_drop(SAMPLES / "published" / "published-gear-lf.json", slope="20", speed="0.5 m/s")


@pytest.mark.parametrize("text", ["0:45", "a", "1,1", "5:0:1", "0:1:0", "", "0:45:1 m"])
def test_grids_that_make_no_sense(text):
    words = "unit 'm' is not a 'deg'" if text.endswith("m") else ""
    with pytest.raises(CampaignError, match=f"--slopes '{text}': {words}"):
        span(text, "--slopes", "deg")


def test_folders_stand_for_what_lies_in_them(tmp_path):
    assert campaign_file(tmp_path / "none.toml") == tmp_path / "none.toml"
    with pytest.raises(CampaignError, match=r"found no \.toml file"):
        campaign_file(tmp_path)
    for name in ("b.toml", "z.csv", "a.h5", "truth.json", ".hidden", "LICENSE.txt", "README"):
        (tmp_path / name).touch()
    assert campaign_file(tmp_path) == tmp_path / "b.toml"
    assert log_files((tmp_path, tmp_path / "c")) == (tmp_path / "a.h5", tmp_path / "z.csv", tmp_path / "c")
    # As a shell writes drops/*: what is no log is left out, and said.
    with pytest.warns(SysidWarning, match=r"truth\.json: is no log; left out"):
        assert log_files((tmp_path / "truth.json", tmp_path / "z.csv")) == (tmp_path / "z.csv",)
    with (
        pytest.warns(SysidWarning, match="no log"),
        pytest.raises(LogError, match="is no log, nor are the other files"),
    ):
        log_files((tmp_path / "truth.json", tmp_path / "b.toml"))
    (tmp_path / "c.toml").touch()
    with pytest.raises(CampaignError, match=r"found b\.toml, c\.toml; name the file"):
        campaign_file(tmp_path)
    (tmp_path / "campaign.toml").touch()
    assert campaign_file(tmp_path) == tmp_path / "campaign.toml"


def every_command():
    """Yield name and command, those of `synthesize` too."""
    program = typer.main.get_command(app)
    for name, one in program.commands.items():
        if one.hidden:
            continue
        below = getattr(one, "commands", {})
        yield from {f"{name} {key}": sub for key, sub in below.items()}.items() if below else [(name, one)]


def test_help_fits_80_columns_lists_every_command_and_ends_with_an_example():
    program = typer.main.get_command(app)
    listed = {name for names in GROUPS.values() for name in names}
    assert {name for name, one in program.commands.items() if not one.hidden} <= listed
    runner = CliRunner()
    whole = runner.invoke(app, ["-h"], terminal_width=80).output
    for code, meaning in EXIT_CODES.items():
        assert f"{code:<4} {meaning}" in whole
    for name, one in every_command():
        text = runner.invoke(app, [*name.split(), "-h"], terminal_width=80).output
        assert max(map(len, text.splitlines())) <= 80, name
        assert re.search(rf"Example:\n *sysid {name}\b", text), name
        # No markup eats the units.
        assert "[deg]" in text or name not in ("simulate", "landing-map", "synthesize gear")
        summary = one.help.partition("\n")[0]
        assert len(summary) <= 60
        assert summary in (whole if " " not in name else runner.invoke(app, [name.split()[0], "-h"]).output)
        if sum(p.param_type_name == "option" for p in one.params) > 8:
            assert "\nOutput:\n" in text, name


def test_a_help_shows_twelve_options_and_help_all_every_one():
    """Rare options are named, and explained by --help-all; `fit` takes a model of one's own."""
    runner, rare = CliRunner(), re.compile(r"^\d+ more, which --help-all explains:\n((?:  --.*\n)+)", re.M)
    for name, one in every_command():
        options = {max(p.opts, key=len) for p in one.params if p.param_type_name == "option"} | {"--help"}
        short = runner.invoke(app, [*name.split(), "-h"], terminal_width=80).output
        shown = set(re.findall(r"^  (?:-\w, )?(--[a-z][\w-]*)", rare.sub("", short), re.M))
        assert len(shown) <= 12, name
        more = rare.search(short)
        named = set(re.findall(r"--[\w-]+", more[1])) if more else set()
        assert shown | named == options, name
        assert not shown & named, name
        whole = runner.invoke(app, [*name.split(), "--help-all"], terminal_width=80).output
        assert set(re.findall(r"^  (?:-\w, )?(--[a-z][\w-]*)", whole, re.M)) == options, name
        assert {"--quiet", "--plugin"} <= options, name
        assert "--plugin" in shown or name != "fit"


def test_quiet_silences_what_is_only_printed_but_not_json(run):
    assert run("codes", "--quiet") == (0, "", "")
    assert run("codes", "odd-kv", "--quiet", "--json")[1].startswith("{")
    sets = [SAMPLES / "published" / f"published-{name}.json" for name in ("gear-lf", "motor")]
    land = (
        "simulate",
        sets[0],
        "--motor",
        sets[1],
        "--slope",
        "20 deg",
        "--speed",
        "0.5",
        "--horizon",
        "0.1",
    )
    assert run(*land, "--quiet") == (0, "", "")
    assert run(*land, "--quiet", "--json")[1].startswith("[")


def test_former_names_stay_as_hidden_commands():
    """`fits`, `cross-validate` and `ladder` run what took their place."""
    commands = typer.main.get_command(app).commands
    former = {"fits": "show", "cross-validate": "validate", "ladder": "explain"}
    assert {name for name, one in commands.items() if one.hidden} == set(former)
    for old, new in former.items():
        assert [p.opts for p in commands[old].params] == [p.opts for p in commands[new].params]
    assert {"fit", "fit-gear", "fit-motor"} <= set(GROUPS["Fit"])


def test_an_option_means_the_same_in_every_command():
    """Only files, rates, laws and grids say in each command what they are about."""
    own = {"--out", "--figure", "--seed", "--rate", "--surface", "--slope", "--slopes", "--speeds", "--help"}
    meant = {}
    for name, one in every_command():
        for param in one.params:
            for option in getattr(param, "opts", ()):
                if option.startswith("--") and option not in own:
                    meaning = (param.help or "").removesuffix(" Repeat it for several.")
                    assert meant.setdefault(option, meaning) == meaning, (name, option)


@pytest.mark.parametrize("settings", [MapSettings(), ImpulseSettings(), StudySettings(), Rules()])
def test_the_help_shows_the_defaults_of_grids(settings):
    for name, hint in field_hints(type(settings)).items():
        flag = mark_of(hint)
        if flag and flag.read and flag.names != ("--spread",):
            assert flag.read(flag.default, name) == getattr(settings, name)
