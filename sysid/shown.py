"""Results as tables: what a notebook shows and `to_frame` returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sized
from dataclasses import fields
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

# A longer table is shown with its middle left out.
_MOST_ROWS = 12


class Shown(ABC):
    """A result with a table; a notebook shows its `repr`, the table and the `remarks`."""

    @abstractmethod
    def to_frame(self) -> pd.DataFrame:
        """Return the result as a table."""

    def remarks(self) -> Iterable[object]:
        """Return the sentences about the result."""
        return ()

    def _repr_html_(self) -> str:
        lines = "".join(f"<li>{escape(str(line))}</li>" for line in self.remarks())
        table = self.to_frame().to_html(max_rows=_MOST_ROWS, border=0, float_format="{:.6g}".format)
        return f"<p>{escape(repr(self))}</p>{table}" + (f"<ul>{lines}</ul>" if lines else "")


class Brief:
    """A dataclass whose `repr` says the shape of arrays and the length of lists."""

    def __repr__(self) -> str:
        parts = ", ".join(f"{f.name}={_brief(getattr(self, f.name))}" for f in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({parts})"


def _brief(value: object) -> str:
    if isinstance(value, np.ndarray | np.generic):
        return str(value.shape) if value.shape else f"{value:g}"
    if isinstance(value, Sized) and not isinstance(value, str) and len(value) > 2:
        return f"<{len(value)}>"
    text = repr(value)
    return text if len(text) <= 80 else f"<{type(value).__name__}>"
