"""``metrics.json`` against its schema, docs/metrics.schema.json, as a stranger's program would check it."""

import json
from pathlib import Path
from typing import Any

import jsonschema

from jaxplan.interception import Episode
from jaxplan.metrics import episode_metrics

SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "metrics.schema.json"


def schema() -> dict[str, Any]:
    """The schema, itself checked."""
    found = json.loads(SCHEMA.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(found)
    return found


def valid_metrics(episode: Episode) -> dict[str, Any]:
    """The metrics of an episode, after a way through JSON and the schema."""
    metrics = json.loads(json.dumps(episode_metrics(episode), allow_nan=False))
    jsonschema.validate(metrics, schema(), cls=jsonschema.Draft202012Validator)
    return metrics
