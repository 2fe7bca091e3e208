"""Make what no damaged file changes once per process.

It takes up to 50 times as long as reading a small file.
"""

from __future__ import annotations

import copy
import functools
from importlib import metadata
from typing import Any

import typer.main
from jinja2 import Environment
from rosbags.highlevel import anyreader
from rosbags.typesys.store import Typestore
from ruamel.yaml import YAML

from dynaviz.contracts import registry
from dynaviz.views.read import chunks


def read_once() -> None:
    """Keep the entry points of plug-ins, versions, the tree of commands, compiled templates, and
    what the same text or chunk contains.

    Changes these libraries for the rest of the process. Others, such as damaged ones, are read as
    usual.
    """
    metadata.version = functools.cache(metadata.version)
    chunks._problem = functools.lru_cache(2000)(chunks._problem)  # type: ignore[assignment]
    registry.handles = functools.cache(registry.handles)
    typer.main.get_command = functools.cache(typer.main.get_command)  # type: ignore[assignment]
    anyreader.get_types_from_msg = functools.lru_cache(1000)(anyreader.get_types_from_msg)  # type: ignore[assignment]

    load = YAML.load
    parsed = functools.lru_cache(1000)(lambda text: load(YAML(typ="safe"), text))
    YAML.load = lambda self, text: copy.deepcopy(parsed(text))

    register, known = Typestore.register, dict[str, dict[str, Any]]()

    def register_once(store: Typestore, types: Any) -> None:
        key = repr((store.fielddefs, types))
        if key not in known:
            register(store, types)
            known[key] = vars(store).copy()
        vars(store).update(known[key])  # with the code that was generated for its messages

    Typestore.register = register_once  # type: ignore[method-assign]

    compiled, codes = Environment.compile, dict[str, Any]()

    def compile_once(self: Environment, source: Any, *names: Any, **options: Any) -> Any:
        if source not in codes:
            codes[source] = compiled(self, source, *names, **options)
        return codes[source]

    Environment.compile = compile_once  # type: ignore[method-assign,assignment]
