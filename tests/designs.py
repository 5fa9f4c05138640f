"""Least-squares problems of warps and surfaces, from data and control points or a lifting."""

from mexpress.models import CardinalBasis, NestedBasis
from mexpress.selection.data import Matches, Samples


def warp_design(lifting, source, target, fractional=True, over_data=None):
    return Matches.of(source, target).design(CardinalBasis(lifting), fractional, over_data)


def nested_warp_design(source, target, control_points, fractional=True):
    return Matches.of(source, target).design(NestedBasis(control_points), fractional)


def surface_design(lifting, points, values):
    return Samples.of(points, values).design(CardinalBasis(lifting))


def nested_surface_design(points, values, control_points):
    return Samples.of(points, values).design(NestedBasis(control_points))
