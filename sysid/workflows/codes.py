"""`sysid codes`: what lies behind the codes of warnings."""

import tomllib
from difflib import get_close_matches
from importlib.resources import files

from sysid.errors import SysidError
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.table import listed

CODES: dict[str, str] = tomllib.loads(
    files("sysid").joinpath("templates/codes.toml").read_text(encoding="utf-8")
)


def print_codes(code: str | None, json: bool) -> None:
    """Print what a code means and what to do; without one, all codes."""
    if code is not None and (code := code.strip("[]")) not in CODES:
        near = " or ".join(get_close_matches(code, CODES, n=3))
        hint = f"did you mean {near}?" if near else "sysid codes lists all"
        raise SysidError(f"unknown code {code!r}; {hint}")
    chosen = CODES if code is None else {code: CODES[code]}
    if print_result(chosen, json):
        return
    if code is not None:
        print_lines(chosen.values())
    else:
        print_table(listed("", chosen.items(), ("code", "what it means, and what to do"), texts=2))
