"""The page and the schema of ``metrics.json`` say the same; that both are true is for the tests of episodes."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from jaxplan.interception import RealTime
from jaxplan.metrics import _real_time
from jaxplan.runtime.records import Phase, RuntimeStatus
from jaxplan.status import PlanStatus
from oracles.metrics_schema import schema


def fields(properties: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """Dotted names; quantiles are no fields of their own."""
    for name, value in properties.items():
        yield prefix + name
        inside = value.get("properties", {})
        if "p50" not in inside:
            yield from fields(inside, f"{prefix}{name}.")


def test_the_page_has_every_field_of_the_schema(repository: Path) -> None:
    page = (repository / "docs" / "metrics.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `([\w.]+)` \|", page, re.MULTILINE) == list(fields(schema()["properties"]))


def test_statuses_are_those_of_the_library() -> None:
    names = schema()["properties"]["replan_status"]["propertyNames"]["enum"]
    assert names == [status.name.lower() for status in PlanStatus]


def test_what_a_run_in_real_time_adds_is_as_the_schema_says() -> None:
    """A whole one takes a minute: ``tests/integration/test_interception.py``."""
    status = RuntimeStatus(Phase.PLANNING, "", 0.1, 0.2, PlanStatus.INTERCEPT, 0.1, 9, 1, {"late": 2}, 0, 0, 860.9)
    kept = RealTime(np.array([3.0, 5.0]), np.array([0.1, 0.3]), status)
    jsonschema.validate(_real_time(kept), schema()["properties"]["real_time"], cls=jsonschema.Draft202012Validator)


@pytest.mark.parametrize("change", [{"succes": True}, {"outcome": "won"}, {"min_distance_m": None}])
def test_the_schema_refuses(change: dict[str, Any]) -> None:
    known = {name: value for name, value in schema()["properties"].items() if name in change}
    part = {**schema(), "properties": known, "required": []}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(change, part, cls=jsonschema.Draft202012Validator)
