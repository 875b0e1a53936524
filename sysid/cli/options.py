"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import typer

Force = Annotated[bool, typer.Option("--force", help="Replace what is there.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, no table.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Resume = Annotated[bool, typer.Option("--resume", help="Continue what was stopped or killed.")]
Dask = Annotated[str | None, typer.Option(help="Compute on a Dask cluster: tcp://host:8786, or local.")]
Threads = Annotated[int | None, typer.Option(help="Cores to use; the result is the same.", min=1)]
Surface = Annotated[
    str | None,
    typer.Option(help="Friction law, such as lf or hf; overrides the campaign.", show_default=False),
]
