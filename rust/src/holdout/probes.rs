//! An estimate of a factored system's smallest eigenvalue: random right-hand sides that ride along tell what pivots hide.

use crate::holdout::kernel::Bordered;

/// Random right-hand sides that tell lambda_min; they fit in the padding of the last panel as a rule.
pub(crate) const PROBES: usize = 2;

/// Random signs in the border below the responses, see [`least_eigenvalue`].
pub(crate) fn set_probes(system: &mut Bordered, order: usize, responses: usize) {
    for probe in 0..PROBES {
        for j in 0..order {
            *system.entry(order + responses + probe, j) = sign(probe, j);
        }
    }
}

/// Factors, and estimates the smallest eigenvalue from above. Pivots alone can hide it (Kahan's triangles), so random
/// signs d ride along below the responses: `d^T M^-1 d` is about 1 / lambda_min once that is small.
pub(crate) fn least_eigenvalue(system: &mut Bordered, order: usize, responses: usize) -> f64 {
    let smallest = system.factor();
    if smallest <= 0.0 {
        return 0.0;
    }
    (responses..responses + PROBES)
        .map(|probe| by_probe(system.forward_products(probe, probe).sum(), order))
        .fold(smallest, f64::min)
}

/// What a probe's `d^T M^-1 d` says of lambda_min, if anything.
pub(crate) fn by_probe(square: f64, order: usize) -> f64 {
    let grown = square - 10.0 * order as f64;
    if grown > 0.0 { grown.recip() } else { f64::INFINITY }
}

/// The j-th of a fixed sequence of signs that no structure of a design knows of.
pub(crate) fn sign(probe: usize, j: usize) -> f64 {
    let mixed = ((j * PROBES + probe + 1) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    if (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 63 == 0 { 1.0 } else { -1.0 }
}
