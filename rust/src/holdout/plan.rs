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

impl Factor {
    /// The multiply-adds of `walk`, at most: those of as many of the largest pairs, as some may hold out most of the rows.
    /// Of neighbourhoods that are not found yet, nobody knows the largest.
    pub fn walk_cost(&self, schemes: &[Scheme<'_>], rows: &Sets) -> f64 {
        let widest = widest(rows);
        let of_all = |scheme: &Scheme<'_>| {
            if scheme.held.listed().is_none() {
                return f64::INFINITY;
            }
            let most = (scheme.held.largest() * widest) as f64;
            let (dual, primal) = costs(most, most, self.rank, false);
            let predictions = most * (self.rank * self.responses) as f64;
            scheme.steps() as f64 * (PAIR + dual.min(primal) + predictions)
        };
        schemes.iter().map(of_all).sum()
    }
}

/// The most rows that a datum has.
fn widest(rows: &Sets) -> usize {
    (0..rows.len()).map(|datum| rows.get(datum).len()).max().unwrap_or(0)
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
    let widest = widest(rows);
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
            let mut sizes: Vec<f64> = chain.schemes.iter().map(size).collect();
            sizes.sort_by(f64::total_cmp);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::scheme::Held;
    use crate::near::neighbours::LazyNeighbourhoods;
    use crate::testing::{Example, pool, sets, singletons, windows};

    fn scheme<'a>(held: &'a Sets, validated: &'a Sets, order: Option<&'a [usize]>) -> Scheme<'a> {
        Scheme { held: Held::Sets(held), validated, order }
    }

    #[test]
    fn balls_around_the_same_data_are_a_chain_the_smaller_first() {
        let (alone, some) = (singletons(9), sets([&[1], &[2]]));
        let (small, large, order) = (windows(9, 1), windows(9, 3), [8, 0, 3, 1, 2, 4, 5, 7, 6]);
        let schemes = [
            scheme(&large, &alone, Some(&order)),
            scheme(&some, &some, None),
            scheme(&alone, &alone, None),
            scheme(&small, &alone, Some(&order)),
            scheme(&small, &alone, Some(&order[..4])),
        ];
        let chains = chains(&schemes);
        let members: Vec<&[usize]> = chains.iter().map(|chain| &chain.schemes[..]).collect();
        assert_eq!(members, [&[2, 3, 0][..], &[1], &[4]]);
        assert_eq!(chains.iter().map(|chain| chain.length).collect::<Vec<_>>(), [9, 2, 4]);
        // Visited in the order that one of its schemes knows, or as listed.
        assert_eq!([chains[0].pair(0), chains[1].pair(1), chains[2].pair(2)], [8, 1, 3]);
        let data: Vec<usize> = visits(&chains, &schemes).collect();
        assert_eq!(data, [&order[..], &[1, 2], &order[..4]].concat());
        let listed = scheme(&small, &alone, None);
        let both = super::chains(&[listed, scheme(&large, &alone, Some(&order))]);
        assert_eq!((both.len(), both[0].order), (1, Some(&order[..])));
        // Some of the data are not visited as all of them are.
        assert_eq!(super::chains(&[scheme(&large, &alone, Some(&order[..4])), listed]).len(), 2);
    }

    /// Whatever a step costs, and if it costs more than a portion should.
    #[test]
    fn portions_cover_every_step_of_every_chain_once() {
        let mut factor = Example::new(40, 3, 1).factor();
        for count in [0, 1, 7, 33, 1000] {
            let (alone, order) = (singletons(count), (0..count).collect::<Vec<_>>());
            let (small, large) = (windows(count, 2), windows(count, 20));
            let schemes = [scheme(&large, &alone, Some(&order)), scheme(&small, &small, None)];
            let chains = chains(&schemes);
            for rank in [0, 3, 5000, 1_000_000_000] {
                factor.rank = rank;
                let portions = portions(&chains, &schemes, &factor, &singletons(40));
                let visited = |chain: &Chain<'_>| {
                    let mine = portions.iter().filter(move |portion| std::ptr::eq(portion.chain, chain));
                    mine.flat_map(|portion| portion.steps.clone()).collect::<Vec<_>>()
                };
                assert!(chains.iter().all(|chain| visited(chain) == order));
                assert!(portions.iter().all(|portion| !portion.steps.is_empty()));
                let lengths = |chain: &Chain<'_>| {
                    let mine = portions.iter().filter(move |portion| std::ptr::eq(portion.chain, chain));
                    mine.map(|portion| portion.steps.len()).collect::<Vec<_>>()
                };
                match rank {
                    // A step that costs more than a portion should is a portion.
                    1_000_000_000 => assert!(chains.iter().all(|chain| lengths(chain) == vec![1; count])),
                    3 => assert!(lengths(&chains[0]).first().is_none_or(|&n| n >= SHARING_STEPS.min(count))),
                    _ => {}
                }
                assert!(rank > 3 || chains.iter().all(|chain| lengths(chain).len() <= PORTIONS + 1));
            }
        }
    }

    /// Sets of one size or of many, of data of one row or of several: no less than each in the way that is the cheaper one,
    /// and of sets and data of one size exactly that.
    #[test]
    fn pairs_take_at_most_what_all_take_one_way() {
        let alone = singletons(40);
        let uneven: Sets = (0..40).map(|i| (0..1 + i * i / 40).collect()).collect();
        let lopsided: Sets =
            std::iter::once((0..30).collect()).chain((30..40).map(|row| vec![row])).collect();
        for (rank, responses) in [(3, 1), (12, 4), (300, 1)] {
            let mut factor = Example::new(40, 3, 1).factor();
            (factor.rank, factor.responses) = (rank, responses);
            for (held, rows) in [(&alone, &alone), (&windows(40, 4), &alone), (&uneven, &alone)] {
                let schemes = [scheme(held, &alone, None)];
                let each = |pair: usize| {
                    let q = rows.total(held.get(pair)) as f64;
                    let (dual, primal) = costs(q, q, rank, false);
                    PAIR + dual.min(primal) + q * (rank * responses) as f64
                };
                let (found, total) = (factor.walk_cost(&schemes, rows), (0..40).map(each).sum::<f64>());
                assert!(found >= total * (1.0 - 1e-12), "{rank}: {found} {total}");
                if std::ptr::eq(held, &alone) {
                    assert!((found / total - 1.0).abs() < 1e-12, "{rank}: {found} {total}");
                }
            }
            let (first, large) =
                (vec![vec![0]; 50].into_iter().collect::<Sets>(), costs(30.0, 30.0, rank, false));
            let found = factor.walk_cost(&[scheme(&first, &first, None)], &lopsided);
            assert!(found >= 50.0 * large.0.min(large.1));
            let order = [39; 40];
            let found = factor.walk_cost(&[scheme(&uneven, &alone, Some(&order))], &alone);
            let large = costs(39.0, 39.0, rank, false);
            assert!(found >= 40.0 * large.0.min(large.1));
        }
    }

    #[test]
    fn dual_and_primal_cost_the_same_for_as_many_rows_as_columns() {
        let (dual, primal) = costs(30.0, 30.0, 30, false);
        assert!((dual / primal - 1.0).abs() < 1e-15);
        let (fewer, more) = (costs(29.0, 29.0, 30, false), costs(31.0, 31.0, 30, false));
        assert!(fewer.0 < fewer.1 && more.0 > more.1);
        // What neighbours share, and what the hat matrix holds, is not computed.
        assert!(costs(31.0, 5.0, 30, false).1 < more.1 && costs(31.0, 31.0, 30, true).0 < more.0);
    }

    #[test]
    fn no_number_of_leading_sets_costs_less() {
        for sizes in [&[1.0, 2.0, 5.0, 9.0][..], &[3.0, 20.0, 21.0, 200.0], &[50.0, 60.0], &[7.0], &[]] {
            for rank in [1, 4, 12, 40, 150] {
                for (shared, hat) in [(true, true), (true, false), (false, true), (false, false)] {
                    let each = |q: f64| costs(q, if shared { rim(q) } else { q }, rank, hat);
                    let apart = |some: &[f64]| some.iter().map(|&q| each(q).0.min(each(q).1)).sum::<f64>();
                    let total =
                        |k: usize| apart(&sizes[k..]) + if k > 0 { each(sizes[k - 1]).0 } else { 0.0 };
                    let least = (0..=sizes.len()).map(total).fold(f64::INFINITY, f64::min);
                    let (count, cost) = lead(sizes, shared, rank, hat);
                    assert!((cost - least).abs() <= 1e-12 * least);
                    assert!((total(count) - least).abs() <= 1e-12 * least);
                }
            }
        }
    }

    #[test]
    fn the_hat_matrix_pays_where_pairs_are_many_and_rows_are_few() {
        let pays = |rows: usize, held: Held<'_>| {
            let mut factor = Example::new(60, 25, 1).factor();
            factor.rows = rows;
            let alone = singletons(60);
            let schemes = [Scheme { held, validated: &alone, order: None }];
            hat_pays(&chains(&schemes), &schemes, &factor, &alone)
        };
        let (several, alone) = (windows(60, 5), singletons(60));
        let places: Vec<f64> = (0..60).map(f64::from).collect();
        let lazy = LazyNeighbourhoods::within(&places, 1, 5.0, &pool(1)).unwrap();
        assert!(pays(60, Held::Sets(&several)));
        assert!(!pays(60, Held::Sets(&alone)));
        assert!(!pays(600, Held::Sets(&several)));
        assert!(!pays(60, Held::Lazy(&lazy)));
        // So many pairs would pay for any number of rows, but for the memory.
        let mut many = Example::new(60, 25, 1).factor();
        (many.rows, many.rank) = (HAT_ROWS + 1, 100);
        let (several, order) = (windows(60, 15), (0..60).cycle().take(20_000).collect::<Vec<_>>());
        let schemes = [scheme(&several, &alone, Some(&order))];
        assert!(!hat_pays(&chains(&schemes), &schemes, &many, &alone));
        many.rows = HAT_ROWS;
        assert!(hat_pays(&chains(&schemes), &schemes, &many, &alone));
    }
}
