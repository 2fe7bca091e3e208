"""The conformance kit: checks that every method must pass. Run them on your own method in one test.

from dynaviz.testing import check_method


def test_my_method():
    check_method(MyMethod)
"""

from dynaviz.testing.checks import CHECKS, check_method
from dynaviz.testing.world import InMemory, crossing

__all__ = ["CHECKS", "InMemory", "check_method", "crossing"]
