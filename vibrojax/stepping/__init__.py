"""Steps forward in time: exact contact, splitting, linearly implicit."""

from vibrojax.stepping.stepper import AbstractStepper as AbstractStepper
