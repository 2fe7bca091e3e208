from __future__ import annotations

from importlib import metadata

import pytest

from dynaviz.contracts import registry
from dynaviz.errors import PluginError, UsageError


def test_built_in_plug_ins_load_and_have_their_name() -> None:
    for handle in registry.handles("methods"):
        assert handle.load().info.name == handle.name
    for kind in ("datasets", "metrics"):
        assert [handle.load() for handle in registry.handles(kind)]


def test_an_unknown_name_suggests_a_similar_one() -> None:
    with pytest.raises(UsageError, match="Did you mean 'octomap'"):
        registry.load("methods", "octomapp")
    with pytest.raises(UsageError, match="Known: "):
        registry.load("methods", "zzz")


def test_loadable_plug_ins_exclude_broken_ones(broken_plugins: None) -> None:
    with pytest.warns(
        UserWarning, match=r"method 'a_broken_one' of somebody's 1\.0 cannot be loaded"
    ):
        found = registry.loadable("methods")
    assert list(found) == [handle.name for handle in registry.handles("methods")][1:]
    assert found["octomap"] is registry.load("methods", "octomap")


def test_a_broken_plug_in_is_listed_and_does_not_affect_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken = metadata.EntryPoint("broken", "no_such_module:Thing", "dynaviz.methods")
    whole = metadata.entry_points(group="dynaviz.methods")
    monkeypatch.setattr(registry.metadata, "entry_points", lambda group: [broken, *whole])
    monkeypatch.setattr(registry, "_handles", registry._handles.__wrapped__)
    assert {"broken", "octomap"} <= {handle.name for handle in registry.handles("methods")}
    assert registry.load("methods", "octomap")
    with pytest.raises(PluginError, match=r"'broken'.*No module named 'no_such_module'"):
        registry.load("methods", "broken")
    assert registry.preset_files()


@pytest.mark.parametrize("handle", registry.handles("datasets"), ids=lambda handle: handle.name)
def test_a_class_is_found_by_its_name_and_the_name_by_the_class(
    handle: registry.PluginHandle,
) -> None:
    """Tables name a format as the command line does, not by its class."""
    assert registry.name_of("datasets", handle.load()) == handle.name


def test_a_class_that_is_no_plugin_has_no_name() -> None:
    assert registry.name_of("datasets", dict) is None
