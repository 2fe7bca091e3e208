from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from helpers.made_results import case

from dynaviz.errors import DataError
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Runtime, Sections, SequenceInfo

RESULT = Result(
    "octomap",
    {"resolution": 0.1},
    SequenceInfo("room", "abc", 2, 10),
    Sections(
        counts={
            "static_kept": 5,
            "static_removed": 1,
            "dynamic_removed": 3,
            "dynamic_kept": 1,
            "unlabelled": 0,
        },
        metrics={"SA": 83.33, "DA": 75.0, "AA": 79.06, "HA": None, "precision": 75.0, "IoU": 60.0},
        other={"total": {"anything": [1, None]}},
    ),
    Runtime(0.1, 0.01, 2, 0.0, 2, 100.0),
    preset="urban",
    parameter_origins={"resolution": "preset urban"},
)


def test_saved_and_loaded_is_the_same(tmp_path: Path) -> None:
    path = tmp_path / "deep/result.json"
    RESULT.save(path)
    assert Result.load(path) == RESULT
    plain = json.loads(path.read_text())
    assert (plain["schema"], plain["n_parameters"], plain["counts"]["static_kept"]) == (1, 1, 5)


def test_a_result_shows_itself_as_a_table() -> None:
    text = str(RESULT)
    assert "octomap" in text
    assert "79.06" in text
    assert "n/a" in text
    assert "octomap" in RESULT._repr_html_()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{", "not valid JSON"),
        ("[]", "not the result of a run"),
        ('{"a": 1}', "not the result of a run"),
        ('{"schema": 99, "method": "x", "parameters": {}, "sequence": {}}', "newer dynaviz"),
    ],
)
def test_a_bad_file_is_named(tmp_path: Path, content: str, says: str) -> None:
    path = tmp_path / "result.json"
    path.write_text(content)
    with pytest.raises(DataError, match=rf"result\.json.*{says}"):
        Result.load(path)
    with pytest.raises(DataError, match="No such file"):
        Result.load(tmp_path / "absent.json")


def test_nothing_appears_where_writing_fails(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        Result("m", {"x": float("nan")}, SequenceInfo()).save(tmp_path / "result.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema": "x"}, None),
        ({"method": 3}, "$.method"),
        ({"runtime": {"mean_s": "fast"}}, "$.runtime.mean_s"),
        ({"counts": {"static_kept": True}}, "$.counts[...]"),
        ({"counts": [1]}, "$.counts"),
        ({"metrics": {"SA": [1.0]}}, "$.metrics[...]"),
        ({"reasons": {"false_positive": 7}}, "$.reasons.false_positive"),
        ({"breakdown": [1]}, "$.breakdown"),
        ({"breakdown": {"range": [{"from": 0, "to": "far"}]}}, "$.breakdown.range[0].to"),
        ({"of_another_metric": [1]}, None),
        ({"of_another_metric": 1, "sections": {}, "other": 3}, None),
    ],
)
def test_a_value_of_the_wrong_type_is_rejected(change: dict[str, Any], says: str | None) -> None:
    plain = {
        "method": "m",
        "parameters": {},
        "sequence": {},
        "metrics": {"SA": None},
        "counts": {"static_kept": 1},
    }
    if says is None:
        Result.from_dict({**plain, **change}, "result.json")
    else:
        with pytest.raises(
            DataError, match=rf"result\.json: is not a valid result: Expected .*`{re.escape(says)}`"
        ):
            Result.from_dict({**plain, **change}, "result.json")


def test_a_failure_case_of_an_unknown_kind_is_rejected() -> None:
    known = case("false_negative", 1.0, (0, 0, 0), (1, 1, 1))
    for kind in ("false_negative", "removed"):
        plain = {
            "method": "m",
            "parameters": {},
            "sequence": {},
            "failures": {"cases": [{**known, "kind": kind}]},
        }
        if kind in known.values():
            assert Result.from_dict(plain, "result.json").failures[0].kind == kind
        else:
            with pytest.raises(DataError, match=r"Invalid enum value 'removed' - at `.*kind`"):
                Result.from_dict(plain, "result.json")


def test_numbers_beyond_64_bits_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text('{"method": "m", "parameters": {}, "sequence": {}, "seed": 1' + 400 * "0" + "}")
    with pytest.raises(
        DataError, match=r"result\.json: not valid JSON \(10000.* has more than 64 bits\)"
    ):
        Result.load(path)


def test_json_nested_without_end_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("[" * 100_000)
    with pytest.raises(DataError, match="not valid JSON"):
        Result.load(tmp_path / "result.json")
