//! What is solved together: pairs around the same data whose held-out sets nest share one factorisation.

use std::ops::Range;

use crate::error::Error;
use crate::fit::factor::Factor;
use crate::fit::linalg;
use crate::holdout::pairs::{Pairs, Status, check_indices};
use crate::pool::Pool;
use crate::sets::Sets;

/// Validated rows that ride along as border rows, instead of a back substitution for all unknowns.
pub(crate) const MOST_CARRIED: usize = 4;

/// Chains around the same data that a set is compared with.
const OPEN: usize = 4;

/// Hat matrices are kept whole up to this many rows (72 MB).
const HAT_ROWS: usize = 3000;

/// Pairs close to rank loss that share a pass over the basis, and how many numbers their systems may have.
const BATCH_PAIRS: usize = 16;
const BATCH_NUMBERS: usize = 4_000_000;

/// What a pair costs beside its multiply-adds, in these.
const OVERHEAD: f64 = 100.0;

/// What is solved together, what it costs, and where its results go; made before anything is solved.
pub(crate) struct Plan {
    /// Pairs that share a factorisation, each inside the next. A single pair takes the cheaper of the two ways.
    pub runs: Sets,
    /// Multiply-adds before each run; one more than the runs.
    cost: Vec<f64>,
    /// Where each pair's validated rows start; one more than the pairs.
    pub offsets: Vec<usize>,
    /// The hat matrix, where it pays.
    pub hat: Option<Hat>,
    /// Rows of the largest pair.
    largest: usize,
}

/// Where a pair's results go.
pub(crate) struct Slot<'a> {
    pub residuals: &'a mut [f64],
    pub status: &'a mut Option<Status>,
}

/// Successive runs, and where their pairs' results go.
pub(crate) struct Chunk<'s, 'a> {
    pub runs: Range<usize>,
    pub slots: &'s mut [Slot<'a>],
}

/// Multiply-adds of the dual and of the primal for q rows.
pub(crate) fn costs(q: usize, rank: usize, hat: bool) -> (f64, f64) {
    let (q, p) = (q as f64, rank as f64);
    let gram = if hat { q } else { q * p / 2.0 };
    (q * gram + q * q * q / 6.0, q * p * p / 2.0 + p * p * p / 6.0)
}

impl Plan {
    pub fn new(factor: &Factor, pairs: &Pairs<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let count = pairs.held.len();
        pairs.check(factor.rows)?;
        let rows =
            |sets: &Sets, s: usize| sets.get(s).iter().map(|&d| pairs.rows.get(d).len()).sum::<usize>();
        let (mut held, mut offsets) = (vec![0; count], vec![0; count + 1]);
        for s in 0..count {
            pool.proceed()?;
            held[s] = rows(pairs.held, s);
            offsets[s + 1] = offsets[s] + rows(pairs.validated, s);
        }
        check_indices(
            &Sets { offsets: vec![0, pairs.order.len()], items: pairs.order.to_vec() },
            pairs.rows.len(),
        )?;
        let visits = visits(pairs.order, pairs.rows.len());
        let mut chains = chains(pairs.held, pairs.validated, &visits, pool)?;
        // Those that validate more than ride along are solved one by one.
        chains.retain(|chain| offsets[chain[0] + 1] - offsets[chain[0]] <= MOST_CARRIED);
        let (runs, cost) = schedule(&chains, &held, factor.rank, false);
        let (by_hat, cost_by_hat) = schedule(&chains, &held, factor.rank, true);
        let whole = (factor.rows as f64).powi(2) * factor.rank as f64 / 2.0;
        let keep_hat = factor.rows <= HAT_ROWS && whole + cost_by_hat[by_hat.len()] < cost[runs.len()];
        let largest = held.into_iter().max().unwrap_or(0);
        Ok(if keep_hat {
            Self {
                runs: by_hat,
                cost: cost_by_hat,
                offsets,
                hat: Some(Hat::new(factor, pairs.rows, &visits, pool)?),
                largest,
            }
        } else {
            Self { runs, cost, offsets, hat: None, largest }
        })
    }

    /// How many pairs are refined at once.
    pub fn batch(&self, rank: usize) -> usize {
        let (q, terms) = (self.largest, if self.hat.is_some() { 0 } else { rank });
        let (dual, primal) = costs(q, rank, self.hat.is_some());
        let system = if dual <= primal { q * (q + terms) } else { rank * (rank + q) };
        (BATCH_NUMBERS / system.max(1)).clamp(1, BATCH_PAIRS)
    }

    /// Where every pair's results go, run after run.
    pub fn slots<'a>(
        &self,
        mut residuals: &'a mut [f64],
        status: &'a mut [Option<Status>],
        responses: usize,
    ) -> Vec<Slot<'a>> {
        let mut places = Vec::with_capacity(status.len());
        for (pair, status) in status.iter_mut().enumerate() {
            let (mine, rest) =
                residuals.split_at_mut((self.offsets[pair + 1] - self.offsets[pair]) * responses);
            residuals = rest;
            places.push(Some(Slot { residuals: mine, status }));
        }
        self.runs.items.iter().filter_map(|&pair| places[pair].take()).collect()
    }

    /// Runs of about equal cost together: several chunks a thread for balance, none so long that it delays an interrupt.
    pub fn chunks<'s, 'a>(&self, mut slots: &'s mut [Slot<'a>], threads: usize) -> Vec<Chunk<'s, 'a>> {
        let count = self.runs.len();
        let target = (self.cost[count] / (8 * threads) as f64).clamp(1e5, 5e7);
        let mut chunks = Vec::new();
        let mut first = 0;
        while first < count {
            let goal = self.cost[first] + target;
            let last = (first + 1..count).find(|&s| self.cost[s] >= goal).unwrap_or(count);
            let (mine, rest) = slots.split_at_mut(self.runs.offsets[last] - self.runs.offsets[first]);
            slots = rest;
            chunks.push(Chunk { runs: first..last, slots: mine });
            first = last;
        }
        chunks
    }
}

/// When each datum is visited: as listed, then those that are not.
fn visits(order: &[usize], count: usize) -> Vec<usize> {
    let mut visits = vec![usize::MAX; count];
    for (next, &datum) in order.iter().chain(&(0..count).collect::<Vec<_>>()).enumerate() {
        visits[datum] = visits[datum].min(next);
    }
    visits
}

/// The hat matrix, its rows in the order of visits: neighbours then share cache lines.
pub(crate) struct Hat {
    values: Vec<f64>,
    /// Where each row of the design is.
    pub place: Vec<usize>,
}

impl Hat {
    fn new(factor: &Factor, rows: &Sets, visits: &[usize], pool: &Pool<'_>) -> Result<Self, Error> {
        const BAND: usize = 64;
        let (m, rank) = (factor.rows, factor.rank);
        let mut data: Vec<usize> = (0..rows.len()).collect();
        data.sort_unstable_by_key(|&datum| visits[datum]);
        let order = data.iter().flat_map(|&datum| rows.get(datum));
        let (mut place, mut basis) = (vec![0; m], Vec::with_capacity(m * rank));
        for (next, &row) in order.enumerate() {
            place[row] = next;
            basis.extend_from_slice(factor.basis_row(row));
        }
        let mut values = vec![0.0; m * m];
        pool.run(
            values.chunks_mut(BAND * m).enumerate(),
            || (),
            |(), (band, out)| linalg::gram_rows(&basis, rank, band * BAND, out, m),
        )?;
        linalg::mirror(&mut values, m);
        Ok(Self { values, place })
    }

    /// The row at a place.
    pub fn line(&self, place: usize) -> &[f64] {
        let m = self.place.len();
        &self.values[place * m..(place + 1) * m]
    }
}

/// Pairs that validate the same data, in order of their sets' sizes, each set inside the next; two pairs or more.
fn chains(
    held: &Sets,
    validated: &Sets,
    visits: &[usize],
    pool: &Pool<'_>,
) -> Result<Vec<Vec<usize>>, Error> {
    let first = |pair: usize| validated.get(pair).first().map(|&datum| (visits[datum], datum));
    let mut order: Vec<_> = (0..held.len()).map(|pair| (first(pair), held.get(pair).len(), pair)).collect();
    order.sort_unstable();
    let mut chains = Vec::new();
    // By their first datum: those that begin alike and go on otherwise may part a chain, which only costs time.
    for group in order.chunk_by(|&(.., a), &(.., b)| validated.get(a) == validated.get(b)) {
        pool.proceed()?;
        let mut open: Vec<Vec<usize>> = Vec::new();
        for (count, &(.., pair)) in group.iter().enumerate() {
            if count % 1000 == 0 {
                pool.proceed()?;
            }
            // Balls have a chain or two: of many sets that do not nest, only the last few are asked.
            let near = open.iter_mut().rev().take(OPEN);
            match near.into_iter().find(|chain| inside(held.get(chain[chain.len() - 1]), held.get(pair))) {
                Some(chain) => chain.push(pair),
                None => open.push(vec![pair]),
            }
        }
        chains.extend(open.into_iter().filter(|chain| chain.len() > 1));
    }
    Ok(chains)
}

/// Whether an increasing list is part of another.
fn inside(small: &[usize], large: &[usize]) -> bool {
    if small.last() > large.last() {
        return false;
    }
    let mut rest = large.iter();
    small.iter().all(|x| rest.by_ref().find(|y| *y >= x) == Some(x))
}

/// What is solved together, and the multiply-adds before each: of a chain as many of the smaller sets as is cheapest.
fn schedule(chains: &[Vec<usize>], held: &[usize], rank: usize, hat: bool) -> (Sets, Vec<f64>) {
    let listing = |pair: usize| (held[pair] * rank) as f64 + OVERHEAD;
    let alone = |pair: usize| {
        let (dual, primal) = costs(held[pair], rank, hat);
        dual.min(primal) + listing(pair)
    };
    let mut runs = Sets { offsets: vec![0], items: Vec::with_capacity(held.len()) };
    let mut cost = vec![0.0];
    let mut add = |pairs: &[usize], price: f64| {
        runs.items.extend_from_slice(pairs);
        runs.offsets.push(runs.items.len());
        cost.push(cost[cost.len() - 1] + price);
    };
    let mut single = vec![true; held.len()];
    for chain in chains {
        let (mut apart, mut best) = (0.0, (0.0, 0, 0.0));
        for (k, &pair) in chain.iter().enumerate() {
            apart += alone(pair);
            let price = costs(held[pair], rank, hat).0 + listing(pair);
            if apart - price > best.0 {
                best = (apart - price, k + 1, price);
            }
        }
        let (_, count, price) = best;
        if count > 1 {
            add(&chain[..count], price);
            chain[..count].iter().for_each(|&pair| single[pair] = false);
        }
    }
    (0..held.len()).filter(|&pair| single[pair]).for_each(|pair| add(&[pair], alone(pair)));
    (runs, cost)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_that_nest_form_chains() {
        let held: Sets =
            [vec![0, 1, 2], vec![1], vec![0, 1], vec![1, 3], vec![4], vec![0, 1]].into_iter().collect();
        let validated: Sets = [1, 1, 1, 1, 4, 0].into_iter().map(|d| vec![d]).collect();
        let never = std::sync::atomic::AtomicBool::new(false);
        let found = chains(&held, &validated, &visits(&[4, 1], 5), &Pool::new(1, &never));
        assert_eq!(found.unwrap(), [vec![1, 2, 0]]);
        let all = |k: usize| (0..k).collect::<Vec<_>>();
        assert!(inside(&[], &[]) && inside(&[2, 5], &[0, 2, 4, 5]) && inside(&all(9), &all(9)));
        assert!(!inside(&[2, 5], &[2, 4]) && !inside(&[0], &[]) && !inside(&[0, 3], &[1, 3]));
    }

    #[test]
    fn a_chain_ends_where_its_sets_cost_more_together() {
        // The primal of the last costs 1e3 p^2 / 2, its dual at least 1e9 / 6.
        let held = [2, 8, 16, 1000];
        let (runs, cost) = schedule(&[vec![0, 1, 2, 3]], &held, 30, false);
        assert_eq!((runs.get(0), runs.get(1), runs.len()), (&[0, 1, 2][..], &[3][..], 2));
        assert!(cost[1] < cost[2] - cost[1]);
        let (runs, _) = schedule(&[], &held, 30, true);
        assert_eq!(runs.items, [0, 1, 2, 3]);
    }
}
