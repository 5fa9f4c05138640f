//! Which pairs are visited together, and in what portions. It depends on the problem alone, never on the number of threads:
//! so do the results.

use std::ops::Range;

use crate::fit::factor::Factor;
use crate::holdout::hat::HAT_ROWS;
use crate::holdout::scheme::Scheme;
use crate::sets::Sets;

/// Multiply-adds of a portion: none delays an interrupt, and none is done before a thread has woken up for it.
const MOST_COST: f64 = 1e9;
const LEAST_COST: f64 = 1e5;

/// What a pair takes beside its arithmetic, in multiply-adds.
const PAIR: f64 = 200.0;

/// Portions of a chain, and the steps that one has if neighbours share their matrices: only its first forms one afresh.
const PORTIONS: usize = 32;
const SHARING_STEPS: usize = 8;

/// Schemes that validate the same data in the same order, those that hold out less first: balls around a datum nest.
pub(super) struct Chain<'a> {
    pub(super) schemes: Vec<usize>,
    pub(super) order: Option<&'a [usize]>,
    pub(super) length: usize,
}

impl Chain<'_> {
    /// The pair that is visited at a step.
    pub(super) fn pair(&self, step: usize) -> usize {
        self.order.map_or(step, |order| order[step])
    }
}

/// Successive steps of a chain.
pub(super) struct Portion<'a> {
    pub(super) chain: &'a Chain<'a>,
    pub(super) steps: Range<usize>,
}

/// All schemes in chains.
pub(super) fn chains<'a>(schemes: &[Scheme<'a>]) -> Vec<Chain<'a>> {
    let mut chains: Vec<Chain<'a>> = Vec::new();
    for (s, scheme) in schemes.iter().enumerate() {
        let alike = |chain: &&mut Chain<'a>| {
            schemes[chain.schemes[0]].validated == scheme.validated
                && chain.length == scheme.steps()
                && (chain.order == scheme.order || chain.order.is_none() || scheme.order.is_none())
        };
        match chains.iter_mut().find(alike) {
            Some(chain) => {
                chain.schemes.push(s);
                chain.order = chain.order.or(scheme.order);
            }
            None => chains.push(Chain { schemes: vec![s], order: scheme.order, length: scheme.steps() }),
        }
    }
    for chain in &mut chains {
        chain.schemes.sort_by(|&s, &t| schemes[s].held.mean().total_cmp(&schemes[t].held.mean()));
    }
    chains
}

/// All chains in portions.
pub(super) fn portions<'a>(
    chains: &'a [Chain<'a>],
    schemes: &[Scheme<'_>],
    factor: &Factor,
    rows: &Sets,
) -> Vec<Portion<'a>> {
    let coupling = factor.rows as f64 / rows.len().max(1) as f64;
    let mut portions = Vec::new();
    for chain in chains {
        let shared = chain.order.is_some();
        let cost = |&s: &usize| {
            let mean = schemes[s].held.mean();
            let changed = if shared { rim(mean) } else { mean };
            let (dual, primal) = costs(coupling * mean, coupling * changed, factor.rank, false);
            PAIR + dual.min(primal)
        };
        let step: f64 = chain.schemes.iter().map(cost).sum();
        let least = ((LEAST_COST / step) as usize).max(if shared { SHARING_STEPS } else { 1 });
        let steps = (chain.length / PORTIONS).max(least).min((MOST_COST / step) as usize).max(1);
        let firsts = (0..chain.length).step_by(steps);
        portions.extend(firsts.map(|first| Portion { chain, steps: first..chain.length.min(first + steps) }));
    }
    portions
}

/// About how many members a neighbourhood does not share with the next: those along its rim.
pub(super) fn rim(members: f64) -> f64 {
    members.min(3.0 * members.sqrt())
}

/// Multiply-adds of the dual and of the primal for q rows, `changed` of which the matrix at hand does not have yet.
pub(super) fn costs(q: f64, changed: f64, rank: usize, hat: bool) -> (f64, f64) {
    let p = rank as f64;
    let gram = if hat { q } else { q * p / 2.0 };
    (q * gram + q * q * q / 6.0, changed * p * p / 2.0 + p * p * p / 6.0)
}

/// How many of the smaller sets of a chain are solved by one dual factorisation (one alone, too, if that is the cheaper way
/// for it), and the multiply-adds of all.
pub(super) fn lead(sizes: &[f64], shared: bool, rank: usize, hat: bool) -> (usize, f64) {
    let alone = |q: f64| {
        let (dual, primal) = costs(q, if shared { rim(q) } else { q }, rank, hat);
        (dual.min(primal), dual)
    };
    let total: f64 = sizes.iter().map(|&q| alone(q).0).sum();
    let (mut apart, mut best) = (0.0, (0, total));
    for (k, &q) in sizes.iter().enumerate() {
        let (cheapest, dual) = alone(q);
        apart += cheapest;
        if total - apart + dual <= best.1 {
            best = (k + 1, total - apart + dual);
        }
    }
    best
}

/// Whether it pays to compute the whole hat matrix.
pub(super) fn hat_pays(chains: &[Chain<'_>], schemes: &[Scheme<'_>], factor: &Factor, rows: &Sets) -> bool {
    if factor.rows > HAT_ROWS {
        return false;
    }
    let Some(held) = schemes.iter().map(|scheme| scheme.held.listed()).collect::<Option<Vec<_>>>() else {
        return false;
    };
    let whole = (factor.rows as f64).powi(2) * factor.rank as f64 / 2.0;
    let widest = (0..rows.len()).map(|datum| rows.get(datum).len()).max().unwrap_or(0);
    let at_most = |scheme: &Scheme<'_>| {
        let rows = (scheme.held.largest() * widest) as f64;
        scheme.steps() as f64 * costs(rows, 0.0, factor.rank, false).0
    };
    if schemes.iter().map(at_most).sum::<f64>() <= whole {
        return false;
    }
    let (mut with, mut without) = (whole, 0.0);
    for chain in chains {
        for step in 0..chain.length {
            let size = |&s: &usize| rows.total(held[s].get(chain.pair(step))) as f64;
            let sizes: Vec<f64> = chain.schemes.iter().map(size).collect();
            with += lead(&sizes, chain.order.is_some(), factor.rank, true).1;
            without += lead(&sizes, chain.order.is_some(), factor.rank, false).1;
        }
    }
    with < without
}

/// The data in the order in which pairs validate them.
pub(super) fn visits<'a>(
    chains: &'a [Chain<'_>],
    schemes: &'a [Scheme<'_>],
) -> impl Iterator<Item = usize> + 'a {
    let validated = |chain: &'a Chain<'_>, step| schemes[chain.schemes[0]].validated.get(chain.pair(step));
    chains
        .iter()
        .flat_map(move |chain| (0..chain.length).flat_map(move |step| validated(chain, step)))
        .copied()
}
