"""Read and validate a campaign file; say every mistake in one sentence."""

import difflib
import hashlib
import re
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.metadata import entry_points
from pathlib import Path
from types import UnionType
from typing import Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from sysid.campaign.common import CampaignSource, CampaignTable, TrialTable, as_exact
from sysid.campaign.gear import GearCampaign
from sysid.campaign.motor import MotorCampaign
from sysid.documents import mistake
from sysid.errors import CampaignFileError
from sysid.recording import file_sha256

Campaign = GearCampaign | MotorCampaign
# Fields of a trial that do not say which part of its log it is.
_NO_PART_OF_A_LOG = {"name", "log", "use", "slope", "point", "down_slope", "direction"}
_KINDS: dict[str, type[BaseModel]] = {"gear": GearCampaign, "motor": MotorCampaign}


def register_campaign(kind: str, model: type[BaseModel]) -> None:
    """Let `read_campaign` read campaigns of another kind."""
    _KINDS[kind] = model


def read_campaign(path: str | Path, kind: str | None = None, *, exact: bool | None = None) -> Campaign:
    """Read a campaign file (TOML; logs in it are named relative to its folder).

    Every stated value is exact where ``[fit]`` says so, or `exact` in its place. A file that is missing, is
    no TOML, has another `kind` than the caller needs, or breaks the schema is a CampaignFileError.
    """
    path = Path(path)
    if path.is_dir():
        raise CampaignFileError(
            f"{path}: is a folder; name the campaign in it, such as {path / 'campaign.toml'}"
        )
    try:
        content = path.read_bytes()
        text = content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except FileNotFoundError:
        absent = CampaignFileError(f"{path}: no such campaign file; 'sysid new-campaign' writes one")
        raise absent.also(FileNotFoundError) from None
    except (OSError, UnicodeDecodeError) as error:
        why: object = error
        if isinstance(error, UnicodeDecodeError):
            why = f"byte {error.object[error.start]:#04x} at {error.start}"
        raise CampaignFileError(
            f"{path}: cannot be read as UTF-8 text ({why}); name a campaign, which is a TOML file in UTF-8"
        ) from error
    try:
        data = tomllib.loads(text)
        unfilled = dict.fromkeys(_unfilled(data, ()))
    # Tables in tables without end are a RecursionError, numbers of thousands of digits a ValueError.
    except (ValueError, RecursionError) as error:
        if path.suffix.lower() != ".toml":
            raise CampaignFileError(
                f"{path}: looks like a log, for it is no TOML ({error}); name a campaign, which "
                "is a TOML file that lists the logs ('sysid new-campaign' writes one)"
            ) from None
        raise CampaignFileError(f"{path}: not valid TOML: {error}; correct that line") from None
    stated = data.get("kind")
    if isinstance(stated, str) and stated not in _KINDS:
        # A module of an installed package registers its kind when it is loaded.
        for point in entry_points(group="sysid.kinds", name=stated):
            point.load()
    if not isinstance(stated, str) or stated not in _KINDS:
        raise CampaignFileError(
            f"{path}: {'states no kind' if stated is None else f'kind is {stated!r}'}; expected "
            f"{' or '.join(map(repr, sorted(_KINDS, reverse=True)))}; "
            "--plugin names the Python file of a model of your own"
        )
    if kind is not None and stated != kind:
        raise CampaignFileError(
            f"{path}: is a {stated} campaign, expected {kind}; use 'sysid fit', or name a {kind} campaign"
        )
    strange = {*data} - {*_KINDS[stated].model_fields}
    for other, model in _KINDS.items():
        if strange and {*data} <= {*model.model_fields}:
            raise CampaignFileError(
                f"{path}: kind is {stated!r}, but {', '.join(sorted(strange))} belong to a {other} campaign; "
                f"write kind = {other!r}"
            )
    if unfilled:
        raise CampaignFileError(
            f"{path}: still TODO: {', '.join(unfilled)}; measure each and write it with its unit "
            f"('sysid new-campaign {stated}' writes a file that says how)"
        )
    try:
        campaign: Campaign = _KINDS[stated].model_validate(data)  # type: ignore[assignment]
    except ValidationError as error:
        raise CampaignFileError(f"{path}: {_first_sentence(error, _KINDS[stated], data)}") from None
    campaign._source = CampaignSource(path, hashlib.sha256(content).hexdigest(), text)
    return as_exact(campaign) if (campaign.fit.exact if exact is None else exact) else campaign


def refuse_repeated_logs(campaign: CampaignTable, path: str | Path) -> None:
    """Refuse two trials of one recording, by content: it would count twice, or validate the fit made from it.

    Trials that state different parts of a log, such as segments or bodies, are different recordings.
    """
    logs: dict[str, Path] = {}
    for trial in campaign.trials:
        # One that is missing is refused where it is read.
        with suppress(CampaignFileError):
            logs[trial.name] = resolve_log(path, trial.log)
    sizes = {name: log.stat().st_size for name, log in logs.items()}
    seen: dict[tuple[str, str], TrialTable] = {}
    for trial in campaign.trials:
        if [*sizes.values()].count(sizes.get(trial.name, -1)) < 2:
            continue
        sha256 = file_sha256(logs[trial.name])
        first = seen.setdefault((sha256, trial.model_dump_json(exclude=_NO_PART_OF_A_LOG)), trial)
        if first is not trial:
            why = "it would count twice" if first.use == trial.use else "a fit predicts its own data"
            raise CampaignFileError(
                f"{path}: trials {first.name!r} ({first.log}) and {trial.name!r} ({trial.log}) are the same "
                f"log (SHA-256 {sha256[:12]}…), so {why}; drop one of them"
            )


def resolve_log(campaign_path: str | Path, log: str) -> Path:
    """Return the path of a log named in a campaign; CampaignFileError when there is no such file."""
    path = Path(campaign_path).parent / log
    try:
        there, folder = path.is_file(), path.is_dir()
    except OSError:  # such as too long a name
        there = folder = False
    if not there:
        found = "is a folder" if folder else "does not exist"
        raise CampaignFileError(
            f"{campaign_path}: log {log!r:.99} {found} in {path.parent}; correct its path"
        )
    return path


def _unfilled(value: object, loc: tuple[int | str, ...], data: object = None) -> Iterator[str]:
    """Yield where a campaign holds a placeholder of `sysid new-campaign` instead of a value."""
    data = value if data is None else data
    if isinstance(value, str) and re.match(r"TODO\b", value):
        # A vector is one thing to measure.
        yield _place(loc[:-1] if isinstance(loc[-1], int) else loc, data)
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _unfilled(inner, (*loc, key), data)


def _first_sentence(error: ValidationError, model: type[BaseModel], data: dict[str, object]) -> str:
    """Turn pydantic's list into one sentence: unknown keys first, since they cause the missing ones."""
    details = sorted(error.errors(include_url=False), key=lambda d: d["type"] != "extra_forbidden")
    detail = details[0]
    where, value = _place(detail["loc"], data), detail.get("input")
    if detail["type"] == "extra_forbidden":
        *table, key = detail["loc"]
        known = _known_keys(model, [part for part in table if isinstance(part, str)])
        lacking = {d["loc"] for d in details if d["type"] == "missing"}
        # Exchanged letters first, then keys that are missing, then by likeness.
        near = sorted(
            difflib.get_close_matches(str(key), known),
            key=lambda one: (sorted(one) != sorted(str(key)), (*table, one) not in lacking),
        )[:1]
        # A required key that was mistyped is missing as well: one mistake, counted once.
        details = [d for d in details if d["type"] != "missing" or d["loc"] != (*table, *near)]
        hint = f"nearest known key is {near[0]!r}" if near else f"known keys are {', '.join(known)}"
        sentence = f"unknown key {where}; {hint}"
    elif detail["type"] == "missing":
        sentence = f"{where} is missing; 'sysid new-campaign' shows how it is written"
    else:
        # A validator of a campaign says what it found.
        shown = detail["type"] != "value_error" and isinstance(value, str | int | float)
        place, value_shown = (f"{where}: " if where else ""), (f", found {value!r}" if shown else "")
        sentence = f"{place}{mistake(detail)}{value_shown}"
    return sentence + (f" (and {len(details) - 1} more)" if len(details) > 1 else "")


def _place(loc: tuple[int | str, ...], data: object) -> str:
    """Write a location as the user sees it: trials are named, not numbered."""
    out = ""
    for key in loc:
        if isinstance(key, int):
            item = data[key] if isinstance(data, list) and key < len(data) else None
            name = item.get("name") if isinstance(item, dict) else None
            out += f"[{name!r}]" if name else f"[{key + 1}]"
            data = item
        else:
            out += f".{key}" if out else key
            data = data.get(key) if isinstance(data, dict) else None
    return out


def _known_keys(annotation: object, tables: Sequence[str]) -> list[str]:
    """Return the keys of a table, reached through `tables` from an annotation (``tuple[GearTrial, ...]``)."""
    if get_origin(annotation) in (tuple, Union, UnionType):
        return next((found for inner in get_args(annotation) if (found := _known_keys(inner, tables))), [])
    if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
        return []
    if not tables:
        return sorted(annotation.model_fields)
    return _known_keys(annotation.model_fields[tables[0]].annotation, tables[1:])
