"""Run the conformance kit on the method.

Odd scans, memory layouts, threads, transformed worlds, states, parameters.
"""

from dynaviz_template.method import Seldom

from dynaviz.testing import check_method


def test_seldom_conforms() -> None:
    """Passes every check with the default parameters."""
    check_method(Seldom)
