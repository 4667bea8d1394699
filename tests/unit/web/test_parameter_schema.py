"""The description of the keys that the page draws its controls from: read off the model, and true to it."""

import pytest

from gateway.config import VisionConfig
from gateway.errors import ConfigError
from gateway.web.profile import parameter_schema

SCHEMA = {key.name: key for key in parameter_schema.schema()}


def test_every_key_of_vision_is_tuned_or_has_a_reason_not_to_be() -> None:
    assert {*parameter_schema.TUNED, "intrinsics", "workers", "affinity", "deadline_s"} == set(
        VisionConfig.model_fields
    )
    assert list(SCHEMA) == list(parameter_schema.TUNED)


def test_every_key_has_a_meaning_and_numbers_have_limits_and_a_unit_where_the_name_has_one() -> None:
    for key in SCHEMA.values():
        assert key.meaning
        assert not key.meaning.startswith(("paper:", "robust:"))
        if key.kind in ("whole", "number"):
            assert key.low is not None
            assert key.high is not None
        assert bool(key.unit) is key.name.endswith(("_px", "_px2", "_s", "_share")), key.name
    assert {key.kind for key in SCHEMA.values()} == {"choice", "flag", "whole", "number", "colour", "rgb"}
    assert {key.belongs for key in SCHEMA.values()} == {"both", "paper", "robust"}


def test_what_the_description_allows_is_what_the_model_takes() -> None:
    for key in SCHEMA.values():
        if key.kind not in ("whole", "number"):
            continue
        for value, fine in ((key.low, True), (key.high, True), (key.low - 1, False), (key.high + 1, False)):  # type: ignore[operator]
            if key.name in ("min_radius_share", "max_radius_share") and fine:
                continue  # each is the other's limit
            try:
                parameter_schema.validated({key.name: value}, VisionConfig())
            except ConfigError:
                assert not fine, (key.name, value)
            else:
                assert fine, (key.name, value)
    assert (SCHEMA["gaussian_kernel_px"].step, SCHEMA["morph_iterations"].step) == (2, 1)
    assert SCHEMA["method"].choices == ("robust", "paper")
    assert SCHEMA["red_low_2"].default == [156, 43, 46]
    assert (SCHEMA["marker_colour"].kind, SCHEMA["marker_colour"].default) == ("rgb", None)


def test_keys_over_others_leave_these_as_they_are_and_set() -> None:
    base = VisionConfig(coast_s=0.2, workers=2)

    made = parameter_schema.validated({"min_fill": 0.5}, base)

    assert made == VisionConfig(coast_s=0.2, workers=2, min_fill=0.5)
    assert made.model_fields_set == {"coast_s", "workers", "min_fill"}
    assert parameter_schema.changes(base, made) == {"min_fill": 0.5}


@pytest.mark.parametrize("key", ["intrinsics", "workers", "affinity", "deadline_s"])
def test_what_belongs_to_camera_or_machine_is_no_part_of_a_profile(key: str) -> None:
    with pytest.raises(ConfigError, match=rf"vision\.{key}: belongs to the (machine|camera)"):
        parameter_schema.validated({key: 1}, VisionConfig())
