"""Steps forward in time: exact contact, splitting, linearly implicit."""

from vibrojax.stepping.method import AbstractMethod as AbstractMethod
