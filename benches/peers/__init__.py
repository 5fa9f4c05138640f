"""Other ways to the same residuals: one adapter for each.

An adapter is a class. ``Adapter(A, b)`` does what can be done before anything is held out;
``residuals(held_out, validated)`` predicts the validated rows of every pair, in order. Adapters of splines are made of
``(points, values, smoothing)``. Where the first column of A is constant, a library may have an intercept in its place.
"""
