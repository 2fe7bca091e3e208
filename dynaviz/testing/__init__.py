"""The conformance kit: what every method must keep to, as checks that anybody runs on a method of their own.

from dynaviz.testing import check_method


def test_my_method():
    check_method(MyMethod)
"""

from dynaviz.testing.checks import CHECKS, check_method
from dynaviz.testing.world import InMemory, crossing

__all__ = ["CHECKS", "InMemory", "check_method", "crossing"]
