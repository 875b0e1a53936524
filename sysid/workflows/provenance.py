"""Where a fit comes from: what identifies it to be continued, and what its record states."""

import hashlib
import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sysid import __version__, exact_json
from sysid.campaign.common import CampaignSource
from sysid.fit.provenance import CampaignFile
from sysid.fit.search import FINISH_POPULATION, run_seeds
from sysid.fit.settings import SearchSettings
from sysid.fit.story import Story

# Libraries that choose the candidates of a search.
_SEARCHING = ("numpy", "scipy", "pymoo", "cma")
_LIBRARIES = (*_SEARCHING, "numba", "pandas", "h5py")


def fit_identity(settings: SearchSettings, story: Story) -> dict[str, Any]:
    """Return what must be equal for a fit to be continued; see `sysid.resume.BlockStore`.

    The story is of all trials.
    """
    problem, space = story.problem, story.problem.space
    rows = [[str(value) for value in vars(row).values()] for row in (*space.table.values(), *space.free)]
    table = exact_json.dumps([rows, dict(space.fixed)], indent=None)
    return {
        "campaign_file": problem.campaign.source.sha256,
        **{f"log {name}": digest for name, digest in story.hashes.items()},
        "version_of_sysid": __version__,
        **{f"version_of_{name}": version(name) for name in _SEARCHING},
        **{f"option_{name}": value for name, value in settings.continued_by().items()},
        "parameter_table": hashlib.sha256(table.encode()).hexdigest(),
        **story.accuracy,
    }


def provenance(settings: SearchSettings, story: Story, folder: Path) -> dict[str, Any]:
    """Return what a reader needs to repeat a fit, or to doubt it.

    The story is of all trials; the campaign's path is stored as seen from the folder of the fit.
    """
    problem = story.problem
    source = problem.campaign.source
    return {
        "sysid": __version__,
        "git_revision": _git_revision(),
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in _LIBRARIES},
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "cores": os.cpu_count(),
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "campaign": {**stated_campaign(source, folder), "text": source.text},
        "logs": dict(story.logs),
        "filter": dict(story.filters),
        "nrmse_denominator": problem.campaign.cost.denominator,
        "search": {
            **vars(settings),
            "run_seeds": list(run_seeds(settings)),
            "finish_population": FINISH_POPULATION,
            "axes": list(problem.space.names),
        },
    }


def stated_campaign(source: CampaignSource, folder: Path) -> CampaignFile:
    """Return what the documents of a fit folder state of a campaign file, as it was read."""
    place = seen_from(folder, source.path)
    return {"file": source.path.name, "sha256": source.sha256, "from_fit_folder": place}


def seen_from(folder: Path, path: Path) -> str:
    """Return the path of a file, seen from a folder; absolute where they share no drive.

    A file that is a link stays one: what it names lies beside the link.
    """
    path = path.parent.resolve() / path.name
    try:
        return Path(os.path.relpath(path, folder.resolve())).as_posix()
    except ValueError:
        return path.as_posix()


def processor() -> str:
    """Return the processor's model: equal bits are promised on equal processors only."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _git_revision() -> str | None:
    """Return the revision of the sources that run, where they lie in a git repository."""
    folder = Path(__file__).resolve().parents[2]
    if not (folder / ".git").exists():
        return None
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
