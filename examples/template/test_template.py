"""Every check of the conformance kit: odd scans, memory, threads, moved worlds, states, parameters."""

from dynaviz_template.method import Seldom

from dynaviz.testing import check_method


def test_seldom_conforms() -> None:
    """The whole kit, with the default parameters."""
    check_method(Seldom)
