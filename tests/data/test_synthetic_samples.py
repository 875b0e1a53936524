"""The sample logs in the repository are those that today's code would write."""

import re
from functools import partial

import numpy as np
import pytest

from fakes.places import SAMPLES
from sysid.campaign.file import read_campaign, resolve_log
from sysid.loaders import detect, load
from sysid.synthetic import read_truth, synthesize_gear, synthesize_motor

# Ten times the quantization or a third of the noise, whichever is smaller: rounding on another processor may
# move a last digit, and a bouncing body multiplies it; a change of physics, seed or format moves far more.
TOLERANCE = {
    "m": 1e-4, "1": 1e-3, "rad/s": 0.3, "N": 0.02, "N·m": 5e-4, "us": 0.0, "V": 1e-3, "A": 1e-2, "s": 1e-6,
}  # fmt: skip
MAKERS = {
    "motor": (synthesize_motor, "motor"),
    "gear-lf": (synthesize_gear, "gear"),
    "gear-hf": (partial(synthesize_gear, surface="hf"), "gear"),
}


@pytest.mark.parametrize("folder", list(MAKERS))
def test_synthetic_samples_are_current(folder, tmp_path):
    make, kind = MAKERS[folder]
    committed = SAMPLES / folder
    truth = read_truth(committed)
    fresh = make(tmp_path / folder, seed=truth["seed"])
    assert sorted(f.name for f in fresh.iterdir()) == sorted(f.name for f in committed.iterdir())
    # The samples are read as a lab's campaign is, which knows its values within errors.
    stated = (fresh / "campaign.toml").read_text(encoding="utf-8")
    stated = re.sub(r"(?m)^exact = true .*\n", "", stated)
    assert stated == (committed / "campaign.toml").read_text(encoding="utf-8")
    again = read_truth(fresh)
    # A model may learn new parameters whose nominal value changes nothing.
    assert truth["parameters"].items() <= again["parameters"].items()
    campaign = read_campaign(committed / "campaign.toml", kind)
    for trial in campaign.trials:
        resolve_log(committed / "campaign.toml", trial.log)
    for file in sorted(committed.iterdir()):
        if file.suffix in (".toml", ".json"):
            continue
        committed_log, fresh_log = load(file).channels, load(fresh / file.name).channels
        assert list(committed_log) == list(fresh_log), file.name
        for name, channel in committed_log.items():
            np.testing.assert_array_equal(channel.valid, fresh_log[name].valid, err_msg=f"{file.name} {name}")
            tolerance = TOLERANCE.get(channel.unit)
            if tolerance is not None and channel.valid.any():
                error = np.nanmax(np.abs(channel.values - fresh_log[name].values))
                assert error <= tolerance, f"{file.name} {name} differs by {error} {channel.unit}"


def test_synthetic_samples_are_small_and_named_in_the_readme():
    files = [file for file in SAMPLES.rglob("*") if file.is_file()]
    sizes = {file.relative_to(SAMPLES).as_posix(): file.stat().st_size for file in files}
    assert max(sizes.values()) < 3_000_000, max(sizes, key=sizes.get)
    assert sum(sizes.values()) < 10_000_000
    text = (SAMPLES / "README.md").read_text(encoding="utf-8")
    for folder in MAKERS:
        for file in (SAMPLES / folder).iterdir():
            assert f"`{file.name}`" in text, file.name
    formats = {
        detect(file)
        for folder in MAKERS
        for file in (SAMPLES / folder).iterdir()
        if file.suffix in (".csv", ".h5")
    }
    assert formats == {"rcbenchmark-csv", "load-cell-csv", "load-cell-hdf5", "motive-csv", "pose-table"}
