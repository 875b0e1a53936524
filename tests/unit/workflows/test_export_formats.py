"""Parameter-set files: what they say, how they refuse, and that a full disk harms nothing."""

import csv
import errno
import io
import json
import os

import h5py
import numpy as np
import pytest
import scipy.io

from fakes.fits import made_fit
from fakes.places import SAMPLES
from fakes.sets import made_sets
from sysid.errors import ExportError
from sysid.export import export, load_parameter_sets
from sysid.fit.adequacy import EXPLAINED_BY, NOT_BY, Adequacy
from sysid.fit.store import write_fit
from sysid.parameter_sets import ACCUSED, ParameterRecord, ParameterSets
from sysid.trust.documents import FreeParameter, TrustDocument, stating_intervals

SUFFIXES = ["json", "csv", "h5", "mat"]


def test_json_is_what_a_simulator_wants(tmp_path):
    document = json.loads(export(made_sets(), tmp_path / "x.json").read_text(encoding="utf-8"))
    assert (document["schema"], document["version"]) == ("sysid-parameter-sets", 1)
    best = document["sets"][0]
    assert best["values"]["leg_axial_stiffness"] == 6400.1
    assert best["values"]["saturation_current"] == "Infinity"
    assert best["nrmse_by_trial"]["drop-2"]["z_B"] == 3 / 7
    assert document["sets"][2]["at_bound"] == {"leg_axial_stiffness": -1}
    row = document["parameters"][0]
    assert {"symbol", "unit", "lower", "upper", "scale", "status", "meaning", "source"} <= set(row)
    assert document["settings"]["surface_law"] == "lf"
    assert document["provenance"]["logs"] == {"drop-1.csv": "00ff"}


def test_csv_opens_as_one_table(tmp_path):
    text = export(made_sets(), tmp_path / "x.csv").read_text(encoding="utf-8-sig")
    rows = list(csv.DictReader(io.StringIO(text)))
    (row,) = (r for r in rows if r["name"] == "leg_axial_stiffness")
    assert (row["set_1"], row["unit"], row["status"], row["at_bound_3"]) == ("6400.1", "N/m", "free", "-1")
    assert float(row["mean"]) == pytest.approx(np.mean([6400.1, 6500.3, 2000.1]))
    assert len({len(r) for r in csv.reader(io.StringIO(text))}) == 1


def test_hdf5_has_native_arrays(tmp_path):
    with h5py.File(export(made_sets(), tmp_path / "x.h5")) as file:
        assert file["parameters/symbol"].asstr()[0] == "k_h"
        assert file["values"][0, 0] == 6400.1
        assert np.isnan(file["parameters/lower"][3])
        assert file["trials"].asstr()[:].tolist() == ["drop-1", "drop-2"]


def test_intervals_and_verdicts_are_beside_the_values_for_other_readers(tmp_path):
    judged = {
        "leg_axial_stiffness": {"interval_95": [6e3, 7e3], "open_95": [False, True], "verdict": "weakly"},
        "leg_length": {"interval_95": [0.12, 0.14], "open_95": [False, False], "verdict": "well"},
    }
    sets = made_sets(settings={"intervals": judged})
    wanted = {
        "interval_low": [6e3, np.nan, np.nan, 0.12],
        "interval_high": [np.inf, np.nan, np.nan, 0.14],
        "verdict": ["weakly", "", "", "well"],
    }
    with h5py.File(export(sets, tmp_path / "x.h5")) as file:
        stored = {key: file[f"parameters/{key}"] for key in wanted}
        native = {key: (d.asstr() if key == "verdict" else d)[:].tolist() for key, d in stored.items()}
    np.testing.assert_equal(native, wanted)
    rows = scipy.io.loadmat(export(sets, tmp_path / "x.mat"), simplify_cells=True)["sysid"]["parameters"]
    np.testing.assert_array_equal(rows["interval_low"], wanted["interval_low"])
    np.testing.assert_array_equal(rows["interval_high"], wanted["interval_high"])
    assert [str(np.squeeze(word)) if np.size(word) else "" for word in rows["verdict"]] == wanted["verdict"]
    # A fit without intervals states none.
    with h5py.File(export(made_sets(), tmp_path / "bare.h5")) as file:
        assert not {*wanted} & {*file["parameters"]}


def test_mat_is_a_structure_with_valid_names(tmp_path):
    odd = ParameterRecord("2 k-h", "k", "N/m", "fixed", "", "")
    twin = ParameterRecord("2_k_h", "k", "N/m", "fixed", "", "")
    long = ParameterRecord("a" * 70, "k", "N/m", "fixed", "", "")
    sets = made_sets(
        parameters=(*made_sets().parameters, odd, twin, long),
        values=np.arange(1.0, 22.0).reshape(3, 7),
        at_bound=np.zeros((3, 7)),
    )
    path = export(sets, tmp_path / "x.mat")
    content = scipy.io.loadmat(path, simplify_cells=True)["sysid"]
    assert content["sets"][0]["leg_axial_stiffness"] == 1.0
    assert content["sets"][1]["x_2_k_h"] == 12.0
    assert content["sets"][1]["x_2_k_h_2"] == 13.0
    fields = list(content["sets"][0])
    assert all(len(field) <= 63 and field.isidentifier() for field in fields)
    assert content["nrmse_by_trial"].shape == (3, 2, 2)
    assert load_parameter_sets(path) == sets


def _unit(document):
    next(row for row in document["parameters"] if row["name"] == "body_mass")["unit"] = "g"


def _value(name, value):
    return lambda document: document["sets"][0]["values"].update({name: value})


@pytest.mark.parametrize(("change", "words"), [
    (_unit, "body_mass has the unit 'g', expected 'kg'"),
    (_value("body_mass", -1.2), "body_mass of set 1 is -1.2 kg, expected a finite number above 0"),
    (_value("body_inertia", 0.0), "body_inertia of set 1 is 0 kg·m², expected a finite number above 0"),
    (_value("leg_axial_stiffness", "Infinity"), "leg_axial_stiffness of set 1 is inf N/m, expected a finite"),
    (_value("joint_dz", "-Infinity"), "joint_dz of set 1 is -inf m, expected a finite number"),
    (_value("body_mass", "1.2"), "expected a number, found '1.2'"),
    (_value("body_mass", True), "expected a number, found True"),
    (_value("body_mass", None), "expected a number"),
    (lambda d: d["sets"][0].update(rank=2), "not in the order of their rank"),
])  # fmt: skip
def test_sets_that_no_gear_has_are_refused_when_they_are_read(tmp_path, refused, change, words):
    document = json.loads((SAMPLES / "published/published-gear-lf.json").read_text(encoding="utf-8"))
    change(document)
    path = tmp_path / "sets.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    refused(["sets.json", words], "export", path, "--out", tmp_path / "quad.xml")
    assert not (tmp_path / "quad.xml").exists()


@pytest.mark.parametrize("what", ["unit", "value"])
def test_so_are_sets_of_a_fit_by_whatever_reads_one(tmp_path, refused, what):
    fit = write_fit(made_fit(), tmp_path / "fit")
    (fit / "fit.json").unlink()
    with h5py.File(fit / "fit.h5", "r+") as file:
        if what == "unit":
            stated = json.loads(file["metadata_json"].asstr()[()])
            stated["parameters"][0]["unit"] = "N/mm"
            del file["metadata_json"]
            file["metadata_json"] = json.dumps(stated)
        else:
            file["sets/values"][0, 0] = -6440.0
    words = {
        "unit": "has the unit 'N/mm', expected 'N/m'",
        "value": "of set 1 is -6440 N/m, expected a finite",
    }
    motor = SAMPLES / "published/published-motor.json"
    for command in (
        ("show", fit), ("show", fit / "fit.h5"), ("report", fit), ("static-limits", fit), ("trust", fit),
        ("export", fit, "--out", tmp_path / "a.json"), ("validate", fit, tmp_path / "campaign.toml"),
        ("simulate", fit, "--motor", motor, "--slope", "20 deg", "--speed", "0.5 m/s"),
        ("cross-validate", fit),
    ):  # fmt: skip
        refused(["leg_axial_stiffness", words[what], "run the fit again"], *command)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["fit", "fit.h5", "summary.txt"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_long_settings_survive(tmp_path, suffix):
    # Longer than the 128 KiB that the csv module accepts in one cell by default.
    limit = csv.field_size_limit()
    sets = made_sets(settings={"curve": (np.arange(20_000.0) / 7).tolist()})
    assert load_parameter_sets(export(sets, tmp_path / f"x.{suffix}")) == sets
    assert csv.field_size_limit() == limit


def test_sets_are_equal_to_the_bit_and_known_by_rank():
    assert made_sets().set_values(2)["leg_axial_stiffness"] == 6500.3
    with pytest.raises(ExportError, match="no set of rank 4; there are 3"):
        made_sets().set_values(4)
    values = np.array(made_sets().values)
    values[0, 0] = np.nextafter(values[0, 0], 1e9)
    assert made_sets(values=values) != made_sets()
    assert made_sets(nrmse=[np.nan, 0.1, 0.2]) == made_sets(nrmse=[np.nan, 0.1, 0.2])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_cut_files_are_refused_at_any_length(tmp_path, suffix):
    path = export(made_sets(), tmp_path / f"x.{suffix}")
    whole = path.read_bytes()
    # JSON and CSV may lose their last line end (one and two bytes) and stay whole.
    for cut in {0, 1, 2, 10, 200, *range(500, len(whole) - 1, max(1, len(whole) // 40)), len(whole) - 3}:
        path.write_bytes(whole[:cut])
        with pytest.raises(ExportError, match=r"damaged or cut off|neither JSON|not a parameter-set file"):
            load_parameter_sets(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_unknown_schema_version_is_refused(tmp_path, suffix, monkeypatch):
    for name in ("document", "metadata"):
        newer = getattr(made_sets(), name)().model_copy(update={"version": 2})
        monkeypatch.setattr(ParameterSets, name, lambda sets, newer=newer: newer)
    path = export(made_sets(), tmp_path / f"x.{suffix}")
    monkeypatch.undo()
    with pytest.raises(ExportError, match=r"x\.\w+: .* version 2, expected 1; read it with the version"):
        load_parameter_sets(path)


def test_foreign_files_are_refused(tmp_path):
    foreign = {
        "a.json": b'{"k_h": 6000}',
        "b.json": b"[1, 2]",
        "c.csv": b"Time (s),Thrust (N)\n0,1\n",
        "d.bin": bytes(range(256)),
        "e.csv": b"row,name,symbol,unit,status,\n",
    }
    for name, data in foreign.items():
        (tmp_path / name).write_bytes(data)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["x"] = 1.0
    scipy.io.savemat(tmp_path / "g.mat", {"x": 1.0})
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises(ExportError) as refusal:
            load_parameter_sets(path)
        assert path.name in str(refusal.value)
        assert "\n" not in str(refusal.value)
    with pytest.raises(ExportError, match="cannot be read"):
        load_parameter_sets(tmp_path / "none.json")


def test_inconsistent_json_is_refused(tmp_path):
    for change in (
        lambda d: d["sets"][0]["values"].pop("body_mass"),
        lambda d: d["sets"].reverse(),
        lambda d: d["parameters"][0].update(colour="red"),
        lambda d: d["parameters"][0].update(status="liked"),
        lambda d: d["sets"][0]["values"].update(body_mass=[1, 2]),
        lambda d: d.pop("channels"),
    ):
        document = json.loads(made_sets().document().text())
        change(document)
        path = tmp_path / "x.json"
        path.write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(ExportError, match=r"x\.json: damaged"):
            load_parameter_sets(path)


def test_export_refuses_formats_and_folders_it_does_not_know(tmp_path):
    with pytest.raises(ExportError, match=r"unknown export format '\.xlsx'; expected one of \.json"):
        export(made_sets(), tmp_path / "x.xlsx")
    with pytest.raises(ExportError, match="does not exist"):
        export(made_sets(), tmp_path / "no" / "x.json")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_full_disk_leaves_the_old_file(tmp_path, monkeypatch, suffix, call):
    path = export(made_sets(), tmp_path / f"x.{suffix}")
    before = path.read_bytes()

    def full(*args):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, call, full)
    with pytest.raises(ExportError, match=r"cannot be written \(No space left on device\); .* unchanged"):
        export(made_sets(name="other"), path)
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_infinite_values_have_no_spread():
    assert made_sets().sigma[2] == 0.0
    assert made_sets().mean[2] == np.inf


def test_written_files_have_ordinary_rights(tmp_path):
    path = export(made_sets(), tmp_path / "x.json")
    plain = tmp_path / "plain"
    plain.touch()
    assert path.stat().st_mode == plain.stat().st_mode


def test_a_parameter_that_data_may_only_bound_has_no_digits_until_it_has_an_interval():
    name, said = "leg_axial_stiffness", "k_h was not assessed"
    sets = made_sets(
        settings={"not_assessed": [name]},
        provenance={"findings": [{"code": "not-assessed", "sentence": said}]},
        warnings=(said, "dust"),
    )
    assert [sets.known[name].text(s) for s in range(3)] == ["not assessed"] * 3
    bound = FreeParameter.model_construct(
        name=name, interval_95=[1.0, 7e3], open_95=[True, False], verdict="not_identifiable", doubt=None
    )
    assessed = stating_intervals(sets, TrustDocument.model_construct(parameters=[bound], warnings=[]))
    assert (assessed.known[name].instead, assessed.known[name].text()) == ("≤ 7e+03", "—")
    assert assessed.warnings == ("dust",)


@pytest.mark.parametrize(("verdict", "said"), [(NOT_BY, ["drop-3: the log shows -z"]), (EXPLAINED_BY, None)])
def test_what_a_log_contradicts_is_accused_where_noise_does_not_explain_the_fit(verdict, said):
    finding = {"code": "contradicts-down-slope", "sentence": "the log shows -z", "trials": ["drop-3"]}
    sets = made_sets(provenance={"findings": [finding, {**finding, "code": "roll-matters"}]})
    judged = Adequacy.model_construct(verdict=verdict)
    document = TrustDocument.model_construct(parameters=[], warnings=[], suspects=[], adequacy=judged)
    assert stating_intervals(sets, document).settings.get(ACCUSED) == said
