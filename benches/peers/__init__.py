"""Other ways to the same residuals: one adapter for each.

An adapter is a class. ``Adapter(A, b)`` does what can be done before anything is held out;
``residuals(held_out, validated)`` predicts the validated rows of every pair, in order.
"""
