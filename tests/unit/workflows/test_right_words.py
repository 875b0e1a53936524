"""What commands print is right and said once: verdicts, counts, one number of a fit, repeated logs."""

import json
import re
import shutil
import time
from pathlib import Path

import pytest

from fakes.lag_kind import write_lag
from fakes.places import SAMPLES
from sysid.api import load_fit
from sysid.campaign import read_campaign
from sysid.errors import CampaignFileError
from sysid.fit.store import read_fit
from sysid.gear.plausible import notice_odd_vehicle
from sysid.gear.problem import gear_space
from sysid.journal import Journal, notice, tell
from sysid.report.answer import next_step
from sysid.trust.comparison import known_values
from sysid.trust.documents import TrustDocument
from sysid.workflows import predict
from sysid.workflows.fit import fit_campaign
from sysid.workflows.kinds import open_campaign
from sysid.workflows.options import FitOptions
from sysid.workflows.show import verdict_on


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    """A campaign of four steps, three to fit, and its fit with intervals."""
    folder = tmp_path_factory.mktemp("lag")
    path = write_lag(folder)
    return path, fit_campaign(path, FitOptions(out=folder / "fit", quiet=True))[1]


def test_no_parameter_is_called_identifiable_without_intervals(tmp_path):
    path = write_lag(tmp_path)
    bounds = '[parameters.bounds]\ntime_constant = ["0.01 s", "0.149 s"]\n'
    path.write_text(path.read_text(encoding="utf-8") + bounds, encoding="utf-8")
    result, _ = fit_campaign(path, FitOptions(out=tmp_path / "fit", quiet=True, trust=False))
    said = verdict_on(result)
    assert "every free parameter is identifiable" not in said
    assert "at a bound: time constant; no intervals were computed" in said


def test_every_parameter_is_called_identifiable_with_intervals_alone(lag):
    assert "; every free parameter is identifiable; " in verdict_on(load_fit(lag[1]).result)
    assert "no intervals were computed" in verdict_on(read_fit(lag[1]))


def test_a_fit_has_one_nrmse(lag, run):
    result = read_fit(lag[1])
    number = f"{100 * result.nrmse[0]:.2f} %"
    assert f"NRMSE {number} " in verdict_on(result)
    assert number in run("fits", lag[1].parent)[1]
    # The record of the runs and stages is of the search, which stops at the same number.
    scores = set(re.findall(r"NRMSE (\S+) %", (lag[1] / "summary.txt").read_text(encoding="utf-8")))
    assert {f"{float(score):.2f}" for score in scores} == scores


def test_trials_are_counted_of_all_that_the_findings_are_about(lag, monkeypatch):
    """A validation opens four trials, and predicts the one that the fit has not seen."""
    opened = predict.open_under

    def noticing(*args):
        kind, whole = opened(*args)
        for trial in whole.trials:
            notice("odd", "is odd", trial=trial.name)
        return kind, whole

    monkeypatch.setattr(predict, "open_under", noticing)
    heard = []
    predict.validate_fit(lag[1], lag[0], say=heard.append)
    assert "warning: 4 of 4 trials: is odd [odd]" in heard


def test_quiet_prints_nothing(lag, run):
    path, folder = lag
    copy = folder.with_name("copy")
    shutil.copytree(folder, copy, dirs_exist_ok=True)
    for command in (
        ("check", path), ("trust", folder, "--resamples", "0"), ("validate", folder, path),
        ("cross-validate", folder), ("compare", folder, copy),
    ):  # fmt: skip
        assert run(*command, "--quiet") == (0, "", ""), command
        assert json.loads(run(*command, "--quiet", "--json")[1]), command


@pytest.mark.parametrize(
    ("use", "why"), [("fit", "it would count twice"), ("validate", "a fit predicts its own data")]
)
def test_one_log_in_two_trials_is_refused_by_its_content(tmp_path, use, why):
    path = write_lag(tmp_path)
    shutil.copy(tmp_path / "0.csv", tmp_path / "again.txt")
    text = path.read_text(encoding="utf-8")
    path.write_text(
        f'{text}\n[[trials]]\nname = "twin"\nlog = "again.txt"\nuse = "{use}"\nstep = 0.5\n', encoding="utf-8"
    )
    with pytest.raises(CampaignFileError) as refusal:
        open_campaign(path)
    assert "trials 'step-0' (0.csv) and 'twin' (again.txt) are the same log (SHA-256 " in str(refusal.value)
    assert why in str(refusal.value)


def test_details_are_printed_on_request():
    for details in (False, True):
        heard = []
        with Journal(heard.append, details=details):
            tell("2 drops to fit")
            tell("a curve in a sentence", detail=True)
        assert len(heard) == 1 + details


@pytest.mark.parametrize(
    ("ends", "opened", "said"),
    [
        ([0.001, 2.7], [True, False], "any value ≤ 2.7 s fits alike"),
        ([0.001, 10.0], [True, True], "any value in its bounds fits alike"),
    ],
)
def test_what_the_data_leave_open_is_no_reason_to_record_more(lag, ends, opened, said):
    trust = TrustDocument.read(lag[1])
    row = trust.by_name["time_constant"]
    row = row.model_copy(update={"verdict": "not_identifiable", "interval_95": ends, "open_95": opened})
    trust = trust.model_copy(update={"parameters": [row]})
    step = next_step(read_fit(lag[1]), trust, True, "fits/lag", "drop")
    does = f"time_constant does not matter for these drops: {said}."
    assert step == f"use the sets: `sysid export fits/lag` writes them. {does}"


def test_a_fall_that_is_none_has_no_verdict(drops, run):
    path = Path(drops) / "campaign.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('gravity = "9.81 m/s²"', 'gravity = "3.1 m/s²"'), encoding="utf-8")
    code, out, err = run("check", path)
    assert code == 3, err
    assert "m/s² instead of 3.10" in err
    assert "no verdict" in out
    assert "identifiable" not in out


def test_a_check_gives_no_verdict_where_the_logs_contradict_the_campaign(drops, run):
    path = Path(drops) / "campaign.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('slope = "15 deg"', 'slope = "16.5 deg"'), encoding="utf-8")
    code, out, err = run("check", path, "--json")
    assert code == 3, err
    document = json.loads(out)
    assert document["withheld"]
    assert document["parameters"] == []
    assert any("the campaign states slope" in warning for warning in document["warnings"])


def test_a_time_limit_ends_the_intervals_too(tmp_path, monkeypatch):
    def endless(opened, options, journal):
        while True:
            time.sleep(0.01)

    monkeypatch.setattr("sysid.workflows.fit.assess_opened", endless)
    heard = []
    options = FitOptions(out=tmp_path / "fit", quiet=True, time_limit=8.0)
    result, folder = fit_campaign(write_lag(tmp_path), options, say=heard.append)
    assert heard[-1] == f"warning: no intervals (time limit); run sysid trust {folder} [no-intervals]"
    assert (result.state, result.judged) == ("done", {})
    assert read_fit(folder).state == "done"


def test_a_campaign_of_another_kind_is_named(tmp_path):
    text = (SAMPLES / "gear-lf" / "campaign.toml").read_text(encoding="utf-8")
    path = tmp_path / "drops.toml"
    path.write_text(text.replace('kind = "gear"', 'kind = "motor"'), encoding="utf-8")
    words = r"kind is 'motor', but capture, surface, vehicle belong to a gear campaign; write kind = 'gear'"
    with pytest.raises(CampaignFileError, match=words):
        open_campaign(path)


@pytest.mark.parametrize(("key", "low"), [("runs", "true"), ("seed", "false"), ("cutoff", "true")])
def test_a_truth_is_no_number(tmp_path, key, low):
    path = write_lag(tmp_path)
    text = path.read_text(encoding="utf-8")
    if key == "cutoff":
        text = (SAMPLES / "gear-lf" / "campaign.toml").read_text(
            encoding="utf-8"
        ) + f"[filter]\n{key} = {low}\n"
    else:
        text = re.sub(r"(?m)^runs = .*$", f"{key} = {low}", text)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CampaignFileError, match=rf"{key}.*(= {low}: expected a number|expected a quantity)"):
        read_campaign(path)


def test_a_folder_of_logs_is_shown_the_way_to_a_campaign(tmp_path, refused):
    (tmp_path / "drop.csv").touch()
    refused(f"sysid new-campaign gear (or motor) --minimal --from {tmp_path}", "fit-gear", tmp_path)


def test_the_nearest_fit_is_named(lag, refused, tmp_path):
    parent = lag[1].parent
    refused(["did you mean", str(lag[1])], "trust", parent)
    refused(f"did you mean {lag[1]}", "report", parent / "fiit")
    refused(f"did you mean {lag[1]}?", "trust", lag[1] / "nosuch")
    refused("nosuch.h5: is not there; expected", "report", tmp_path / "nosuch.h5")


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        (
            "thrust_point_dx",
            "7.9 m",
            "thrust_point_dx = 7.9 is 50 × what a vehicle of this mass and size has",
        ),
        ("leg_inertia", "0.02 kg·m²", "leg_inertia = 0.02 is 99 × what"),
        ("leg_mass", "2 kg", "leg_mass = 2 is 100 × what"),
        ("board_length", "12 mm", "board_length = 0.012 is 0.013 × what"),
    ],
)
def test_an_implausible_value_is_named_with_its_ratio(key, value, said, tmp_path):
    text = (SAMPLES / "gear-lf" / "campaign.toml").read_text(encoding="utf-8")
    path = tmp_path / "drops.toml"
    path.write_text(re.sub(rf'(?m)^{key} = "[^"]*"', f'{key} = "{value}"', text), encoding="utf-8")
    for file, expected in ((path, 1), (SAMPLES / "gear-lf" / "campaign.toml", 0)):
        with Journal() as journal:
            notice_odd_vehicle(read_campaign(file, "gear"))
        assert len([each for each in journal.misstated if said in each]) == expected
        assert len(journal.misstated) == expected


def test_the_line_that_goes_on_with_a_fit_works_as_it_is_printed(tmp_path, run):
    path = write_lag(tmp_path, search="runs = 2\n")
    options = ("--population", "16", "--algorithm", "de", "--finish", "none", "--seed", "4", "--exact")
    # The time is over when the first generation is.
    code, out, err = run("fit", path, "--out", tmp_path / "fit", *options, "--time-limit", "1 ms")
    assert code == 0, err
    (line,) = (line.strip() for line in out.splitlines() if "--resume" in line)
    command = line.partition("  ")[0].split()[1:]
    assert not {"--population", "--runs"} & {*command}
    assert run(*command)[0] == 0
    again = read_fit(tmp_path / "fit").provenance["search"]
    assert [again[name] for name in ("population", "algorithm", "finish", "seed", "exact")] == [
        16, "de", "none", 4, True,
    ]  # fmt: skip


def test_known_values_that_differ_are_stated_for_each_fit(tmp_path):
    """A known value of one fit was printed for both."""
    text = (SAMPLES / "gear-lf" / "campaign.toml").read_text(encoding="utf-8")
    spaces = []
    for friction, law in (("0.54", "lf"), ("0.58", "lf"), ("0.54", "hf")):
        path = tmp_path / "drops.toml"
        changed = text.replace("kinetic_friction = 0.44", f"kinetic_friction = {friction}")
        path.write_text(changed.replace('law = "lf"', f'law = "{law}"'), encoding="utf-8")
        spaces.append(gear_space(read_campaign(path, "gear")))
    assert known_values(spaces[:1] * 2) == []
    # Places count from where each campaign states them.
    (row,) = known_values(spaces[:1] * 2, [{}, {"surface_dz": 3e-3}])
    assert (row.parameter, row.values) == ("surface_dz", [0.0, 3e-3])
    (row,) = known_values(spaces[:2])
    assert (row.parameter, row.values) == ("kinetic_friction", [0.54, 0.58])
    free = {row.parameter: row.values for row in known_values(spaces[::2])}
    assert free["leg_mass"] == [0.02, None]
    assert free["kinetic_friction"] == [0.54, None]


def test_a_comparison_begins_with_the_known_values(lag, run):
    copy = lag[1].with_name("copy")
    shutil.copytree(lag[1], copy, dirs_exist_ok=True)
    code, out, err = run("compare", lag[1], copy)
    assert code == 0, err
    assert out.lstrip().startswith("the fits take the same values as known")


def test_eight_drops_are_looked_at_in_a_row_each(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    logs = SAMPLES / "gear-lf"
    lines = run("inspect", logs)[1].splitlines()
    assert len(lines) <= 25
    (row,) = (line.split() for line in lines if "drop-4" in line and "note" not in line)
    # Touchdown [s], its speed [m/s] with its error, and the slope [deg] that its name states.
    assert row[2:] == ["13.493", "1.11", "±", "0.17", "20.0"]
    assert sum("time rebuilt from frame numbers" in line for line in lines) == 1
    assert len(run("inspect", logs, "--details")[1].splitlines()) > 150
    assert "board-1/position" in run("inspect", logs / "drop-1-5deg-0.50mps.csv")[1]


@pytest.mark.slow
def test_a_check_is_short(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = run("check", SAMPLES / "gear-lf")
    assert code == 0, err
    assert len((out + err).splitlines()) <= 25
    assert "not identifiable" in out


def test_validate_alone_is_cross_validation_and_show_lists_a_folder(lag, run):
    alone = json.loads(run("validate", lag[1], "--json")[1])
    assert all("refit" in trial for trial in alone["trials"])
    assert [trial["name"] for trial in alone["trials"]] == ["step-0", "step-1", "step-2"]
    # JSON: the table prints the age of a fit, which may grow between two commands.
    assert run("show", lag[1].parent, "--json")[1] == run("fits", lag[1].parent, "--json")[1] != ""
    assert "age" in run("show", lag[1].parent)[1]
    assert "time_constant" in run("show", lag[1])[1]
