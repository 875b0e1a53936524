"""Landings, in the test's folder and with controllers that no other test sees."""

import pytest

from sysid.landing import controllers
from sysid.resume import BlockStore


@pytest.fixture(autouse=True)
def alone(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(controllers, "CONTROLLERS", dict(controllers.CONTROLLERS))


@pytest.fixture
def done(run):
    """A command that must succeed; returns its output and its errors."""

    def call(*arguments):
        code, out, err = run(*arguments)
        assert code == 0, err
        return out, err

    return call


@pytest.fixture
def killed(run, monkeypatch):
    """A command that is aborted when its first block has been kept."""

    def call(*arguments):
        save = BlockStore.save

        def save_and_die(store, name, columns):
            save(store, name, columns)
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(BlockStore, "save", save_and_die)
            assert run(*arguments)[0] == 130

    return call
