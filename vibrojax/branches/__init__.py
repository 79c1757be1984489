"""Branches of periodic responses, their folds and other special points."""

from vibrojax.branches.branch import Branch as Branch
from vibrojax.branches.branch import Branches as Branches
from vibrojax.branches.fold_curves import FoldCurve as FoldCurve
from vibrojax.branches.fold_curves import FoldCurves as FoldCurves
from vibrojax.branches.folds import Fold as Fold
from vibrojax.branches.points import SpecialPoint as SpecialPoint
