"""`sysid schema`: the JSON Schema of the documents that sysid writes."""

import json

from sysid.documents import Part
from sysid.errors import SysidError
from sysid.fit.provenance import FitDocument
from sysid.parameter_sets import SetsDocument
from sysid.trust.documents import (
    CheckDocument,
    CrossValidationDocument,
    ExplainDocument,
    TrustDocument,
    ValidationDocument,
)

DOCUMENTS: dict[str, type[Part]] = {
    "fit": FitDocument,
    "parameter-sets": SetsDocument,
    "check": CheckDocument,
    "trust": TrustDocument,
    "validation": ValidationDocument,
    "cross-validation": CrossValidationDocument,
    "explain": ExplainDocument,
}


def print_schema(name: str | None) -> None:
    """Print the JSON Schema of a document; without a name, the names.

    Raises `SysidError` for an unknown name.
    """
    if name is None:
        print("\n".join(DOCUMENTS))
        return
    if name not in DOCUMENTS:
        raise SysidError(f"unknown document {name!r}; expected one of {', '.join(DOCUMENTS)}")
    print(json.dumps(DOCUMENTS[name].json_schema(), indent=2, ensure_ascii=False))
