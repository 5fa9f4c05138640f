//! The walk along pairs: each pair's matrix is made from the most similar one known.
//!
//! At a step all pairs of a chain are solved, those that hold out less first. What is asked of them, the residuals of one
//! model or the scores of all leading ones, is the [`Question`].

use crate::error::Error;
use crate::fit::factor::Factor;
use crate::holdout::gram::Gram;
use crate::holdout::hat::Hat;
use crate::holdout::kernel::Bordered;
use crate::holdout::plan::{Chain, Portion};
use crate::holdout::probes::{PROBES, least_eigenvalue, set_probes};
use crate::holdout::scheme::Scheme;
use crate::pool::Pool;
use crate::sets::Sets;

/// What all threads read.
pub(super) struct Ground<'a> {
    pub(super) factor: &'a Factor,
    pub(super) schemes: &'a [Scheme<'a>],
    pub(super) rows: &'a Sets<'a>,
    /// The hat matrix, where it pays.
    pub(super) hat: Option<Hat>,
}

impl Ground<'_> {
    pub(super) fn rows_of(&self, data: &[usize]) -> Vec<usize> {
        data.iter().flat_map(|&datum| self.rows.get(datum)).copied().collect()
    }

    /// The data that a pair holds out.
    pub(super) fn members(&self, scheme: usize, pair: usize) -> Vec<usize> {
        let mut members = Vec::new();
        self.schemes[scheme].held.members(pair, &mut members);
        members
    }

    /// What the pairs of a chain validate at a step.
    pub(super) fn validated(&self, at: Visit<'_>) -> &[usize] {
        self.schemes[at.chain.schemes[at.k]].validated.get(at.chain.pair(at.step))
    }
}

/// The k-th pair of a chain at a step.
#[derive(Clone, Copy)]
pub(super) struct Visit<'a> {
    pub(super) chain: &'a Chain<'a>,
    pub(super) step: usize,
    pub(super) k: usize,
}

/// What is asked of the pairs.
pub(super) trait Question: Sync {
    /// What is found on a portion of the way.
    type Answer: Send;

    /// Answers a portion at once, if its pairs are simple enough.
    fn at_once(&self, _: &Portion<'_>, _: &mut Self::Answer) -> bool {
        false
    }

    /// Solves pairs of a step together, in the dual, the first of the chain's `order`, and tells how many.
    fn together(&self, _: &mut Workspace, _: Visit<'_>, _: &[usize], _: &mut Self::Answer) -> usize {
        0
    }

    /// Solves a pair in the dual, if that costs less than this many multiply-adds and is accurate.
    fn dual(&self, work: &mut Workspace, at: Visit<'_>, primal: f64, answer: &mut Self::Answer) -> bool;

    /// Solves a pair by its matrix, the k-th of `work.last`, or by the factor of this very matrix that the system holds.
    fn primal(&self, work: &mut Workspace, at: Visit<'_>, pool: &Pool<'_>, answer: &mut Self::Answer);
}

/// Walks along all portions.
pub(super) fn walk<Q: Question>(
    ground: &Ground<'_>,
    question: &Q,
    portions: &[Portion<'_>],
    answers: &mut [Q::Answer],
    pool: &Pool<'_>,
) -> Result<(), Error> {
    pool.run(
        portions.iter().zip(answers),
        || Workspace::new(ground.rows.len()),
        |work, (portion, answer)| {
            if question.at_once(portion, answer) {
                return;
            }
            work.start(ground, portion.chain.schemes.len());
            for step in portion.steps.clone() {
                work.step(ground, question, Visit { chain: portion.chain, step, k: 0 }, pool, answer);
            }
        },
    )
}

/// The matrix of one scheme's last pair, and whose rows it left out.
#[derive(Default)]
pub(super) struct LastPair<G> {
    pub(super) gram: G,
    pub(super) members: Vec<usize>,
    /// By datum, whether it is one of the members.
    pub(super) inside: Vec<bool>,
}

impl<G> LastPair<G> {
    /// Nothing is held out of `count` data.
    pub(super) fn clear(&mut self, count: usize) {
        self.inside.resize(count, false);
        self.set_members(&[]);
    }

    pub(super) fn set_members(&mut self, members: &[usize]) {
        self.members.iter().for_each(|&datum| self.inside[datum] = false);
        members.iter().for_each(|&datum| self.inside[datum] = true);
        members.clone_into(&mut self.members);
    }
}

/// How one set of data becomes another.
#[derive(Default)]
pub(super) struct SetChange {
    pub(super) added: Vec<usize>,
    pub(super) removed: Vec<usize>,
}

impl SetChange {
    pub(super) fn len(&self) -> usize {
        self.added.len() + self.removed.len()
    }

    /// From the members of `last` to those that bear the stamp `now`.
    fn find<G>(&mut self, last: &LastPair<G>, members: &[usize], stamps: &[u64], now: u64) {
        self.added.clear();
        self.added.extend(members.iter().filter(|&&datum| !last.inside[datum]));
        self.removed.clear();
        self.removed.extend(last.members.iter().filter(|&&datum| stamps[datum] != now));
    }
}

/// Everything a thread needs to solve pairs; after the largest pair it allocates no more.
pub(super) struct Workspace {
    pub(super) system: Bordered,
    /// One a scheme of the chain.
    pub(super) last: Vec<LastPair<Gram>>,
    /// Data that each pair of the step holds out.
    pub(super) members: Vec<Vec<usize>>,
    /// The pairs of the step, those that hold out less first: on average a chain has them so, but not around every datum.
    order: Vec<usize>,
    /// By datum, when it was last listed.
    stamps: Vec<u64>,
    now: u64,
    slide: SetChange,
    ring: SetChange,
    changed_rows: Vec<usize>,
    /// Held-out rows at hand: the validated ones, then those that each pair holds out beyond the one before.
    pub(super) rows: Vec<usize>,
    pub(super) validated: usize,
    /// How many of `rows` each pair holds out.
    pub(super) ends: Vec<usize>,
    /// Their places in the hat matrix.
    pub(super) places: Vec<usize>,
    /// Estimates of lambda_min(M), one a pair.
    pub(super) least: Vec<f64>,
    /// Whose matrix the system holds the factor of, and the estimate of its smallest eigenvalue: data in a cluster tend to
    /// hold out the same.
    pub(super) factored: Option<(usize, f64)>,
}

impl Workspace {
    /// For so many data.
    pub(super) fn new(data: usize) -> Self {
        Self {
            system: Bordered::default(),
            last: Vec::new(),
            members: vec![Vec::new()],
            order: Vec::new(),
            stamps: vec![0; data],
            now: 0,
            slide: SetChange::default(),
            ring: SetChange::default(),
            changed_rows: Vec::new(),
            rows: Vec::new(),
            validated: 0,
            ends: Vec::new(),
            places: Vec::new(),
            least: Vec::new(),
            factored: None,
        }
    }

    /// Starts afresh: nothing is held out.
    fn start(&mut self, ground: &Ground<'_>, schemes: usize) {
        self.last.resize_with(schemes.max(self.last.len()), LastPair::default);
        self.members.resize(schemes.max(self.members.len()), Vec::new());
        for last in &mut self.last[..schemes] {
            last.clear(ground.rows.len());
            last.gram.clear();
        }
        self.factored = None;
    }

    /// Solves the pairs of a step.
    fn step<Q: Question>(
        &mut self,
        ground: &Ground<'_>,
        question: &Q,
        at: Visit<'_>,
        pool: &Pool<'_>,
        answer: &mut Q::Answer,
    ) {
        let pair = at.chain.pair(at.step);
        for (&s, members) in at.chain.schemes.iter().zip(&mut self.members) {
            ground.schemes[s].held.members(pair, members);
        }
        let mut order = std::mem::take(&mut self.order);
        order.clear();
        order.extend(0..at.chain.schemes.len());
        order.sort_by_key(|&k| self.members[k].len());
        let together = question.together(self, at, &order, answer);
        for k in 0..at.chain.schemes.len() {
            if order[..together].contains(&k) {
                continue;
            }
            let at = Visit { k, ..at };
            self.list(ground, ground.validated(at), &[k]);
            let inner = self.find_change(k);
            let changed = if inner { &self.ring } else { &self.slide }.len().min(self.members[k].len());
            let rows = changed as f64 * self.rows.len() as f64 / self.members[k].len().max(1) as f64;
            let p = ground.factor.rank as f64;
            if !question.dual(self, at, p * p * (rows / 2.0 + p / 6.0), answer) {
                if changed > 0 || inner || self.last[k].gram.is_empty() {
                    self.update_gram(ground, k, inner);
                    self.factored = None;
                }
                question.primal(self, at, pool, answer);
            }
        }
        self.order = order;
    }

    /// Lists the rows of pairs that validate the same data. False if they do not nest in this order.
    pub(super) fn list(&mut self, ground: &Ground<'_>, validated: &[usize], pairs: &[usize]) -> bool {
        let Self { rows, stamps, members, ends, .. } = self;
        self.now += 1;
        rows.clear();
        ends.clear();
        let mut listed = 0;
        let mut add = |rows: &mut Vec<usize>, datum: usize| {
            if stamps[datum] != self.now {
                stamps[datum] = self.now;
                listed += 1;
                match ground.rows.get(datum) {
                    // Without the call that copies a slice: most data have a single row.
                    &[row] => rows.push(row),
                    several => rows.extend_from_slice(several),
                }
            }
            listed
        };
        let mut nest = true;
        for &datum in validated {
            add(rows, datum);
        }
        self.validated = rows.len();
        for &pair in pairs {
            let members = &members[pair];
            let count = members.iter().fold(0, |_, &datum| add(rows, datum));
            nest &= count == members.len();
            ends.push(rows.len());
        }
        nest
    }

    /// Finds how the matrix of the pair that is listed comes from the one before along the way, or from that of the
    /// scheme which holds out less: then true.
    fn find_change(&mut self, k: usize) -> bool {
        let Self { last, members, stamps, now, slide, ring, .. } = self;
        slide.find(&last[k], &members[k], stamps, *now);
        k > 0 && {
            ring.find(&last[k - 1], &members[k], stamps, *now);
            ring.len() < slide.len()
        }
    }

    /// Turns the k-th matrix into that of the pair at hand, starting from the most similar one known.
    fn update_gram(&mut self, ground: &Ground<'_>, k: usize, inner: bool) {
        let factor = ground.factor;
        let Self { last, members, slide, ring, changed_rows, .. } = self;
        let (before, rest) = last.split_at_mut(k);
        let last = &mut rest[0];
        let change = if inner { ring } else { slide };
        if change.len() >= members[k].len() {
            last.gram.start(factor.rank, factor.responses);
            change.removed.clear();
            change.added.clone_from(&members[k]);
        } else if inner {
            last.gram.copy_from(&before[k - 1].gram);
        }
        for (data, sign) in [(&change.added, -1.0), (&change.removed, 1.0)] {
            changed_rows.clear();
            changed_rows.extend(data.iter().flat_map(|&datum| ground.rows.get(datum)));
            last.gram.change(changed_rows, sign, |i| (factor.basis_row(i), factor.residual_row(i)));
        }
        last.set_members(&members[k]);
    }

    /// Lists a pair on its own.
    pub(super) fn list_pair(&mut self, ground: &Ground<'_>, s: usize, pair: usize) {
        let scheme = &ground.schemes[s];
        scheme.held.members(pair, &mut self.members[0]);
        self.list(ground, scheme.validated.get(pair), &[0]);
    }

    /// How a matrix comes from another pair's to that of the pair at hand, which is listed on its own.
    pub(super) fn change_from<G>(&mut self, last: &LastPair<G>) -> &mut SetChange {
        self.slide.find(last, &self.members[0], &self.stamps, self.now);
        &mut self.slide
    }

    /// The estimate of the k-th matrix' smallest eigenvalue, if the system holds its factor.
    pub(super) fn known_least(&self, k: usize) -> Option<f64> {
        self.factored.filter(|&(which, _)| which == k).map(|(_, least)| least)
    }

    /// Factors the k-th matrix with probes and the first `carried` rows in its border; an estimate of its smallest eigenvalue.
    pub(super) fn factor_primal(&mut self, factor: &Factor, k: usize, carried: usize) -> f64 {
        self.system.start_from(&self.last[k].gram, PROBES + carried);
        set_probes(&mut self.system, factor.rank, factor.responses);
        for (line, &row) in self.rows[..carried].iter().enumerate() {
            let line = factor.rank + factor.responses + PROBES + line;
            for (j, &q) in factor.basis_row(row).iter().enumerate() {
                *self.system.entry(line, j) = q;
            }
        }
        let least = least_eigenvalue(&mut self.system, factor.rank, factor.responses);
        self.factored = Some((k, least));
        least
    }

    /// Makes the first matrix that of the rows at hand.
    pub(super) fn fresh_gram(&mut self, factor: &Factor) {
        self.last.resize_with(self.last.len().max(1), LastPair::default);
        let gram = &mut self.last[0].gram;
        gram.start(factor.rank, factor.responses);
        gram.change(&self.rows, -1.0, |i| (factor.basis_row(i), factor.residual_row(i)));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::fit::linalg::dot;
    use crate::fit::panels::PANEL;
    use crate::holdout::plan::{chains, portions};
    use crate::holdout::scheme::Held;
    use crate::testing::{Example, assert_close, bits, pool, sets, singletons, windows};

    fn scheme<'a>(held: &'a Sets, validated: &'a Sets, order: Option<&'a [usize]>) -> Scheme<'a> {
        Scheme { held: Held::Sets(held), validated, order }
    }

    /// The lower triangle and the right-hand sides below it.
    fn entries(gram: &Gram) -> Vec<f64> {
        let (order, border) = gram.shape();
        let entry = |i: usize, j: usize| gram.panel(i / PANEL)[j * PANEL + i % PANEL];
        (0..order + border).flat_map(|i| (0..order.min(i + 1)).map(move |j| entry(i, j))).collect()
    }

    /// `I - Q_K^T Q_K` above `-Q_K^T e_K`.
    fn expected(factor: &Factor, held: &[usize]) -> Vec<f64> {
        let column = |k: usize| {
            let entry = move |i: usize| match k.checked_sub(factor.rank) {
                None => factor.basis_row(i)[k],
                Some(c) => factor.residual_row(i)[c],
            };
            held.iter().map(|&i| entry(i)).collect::<Vec<f64>>()
        };
        let entry = |i, j| f64::from(u8::from(i == j)) - dot(&column(i), &column(j));
        let lines = 0..factor.rank + factor.responses;
        lines
            .flat_map(|i| (0..factor.rank.min(i + 1)).map(move |j| (i, j)))
            .map(|(i, j)| entry(i, j))
            .collect()
    }

    /// Asks for every matrix on the way, and how it was made.
    struct Matrices<'a>(&'a Ground<'a>, Mutex<[usize; 4]>);

    impl Question for Matrices<'_> {
        type Answer = Vec<f64>;

        fn dual(&self, _: &mut Workspace, _: Visit<'_>, _: f64, _: &mut Vec<f64>) -> bool {
            false
        }

        fn primal(&self, work: &mut Workspace, at: Visit<'_>, _: &Pool<'_>, answer: &mut Vec<f64>) {
            let held = work.rows.len();
            let (slide, ring) = (work.slide.len(), if at.k > 0 { work.ring.len() } else { usize::MAX });
            let way = if slide.min(ring) == 0 {
                3
            } else if slide.min(ring) == held {
                2
            } else {
                usize::from(ring < slide)
            };
            self.1.lock().unwrap()[way] += 1;
            let found = entries(&work.last[at.k].gram);
            assert_close(&found, &expected(self.0.factor, &work.rows), 1e-14);
            answer.extend(found);
        }
    }

    /// Neighbours, jumps, balls inside each other, sets that come twice: whatever it is made from, a matrix is the same, and
    /// its bits do not depend on threads.
    #[test]
    fn every_matrix_is_that_of_its_held_out_rows_however_it_was_made() {
        let (factor, alone) = (Example::new(60, 11, 2).factor(), singletons(60));
        let (small, large) = (windows(60, 4), windows(60, 6));
        let order: Vec<usize> = (0..30).chain([59, 31, 45, 45]).chain(32..59).collect();
        let schemes = [scheme(&large, &alone, Some(&order)), scheme(&small, &alone, Some(&order))];
        let ground = Ground { factor: &factor, schemes: &schemes, rows: &alone, hat: None };
        let chains = chains(&schemes);
        let portions = portions(&chains, &schemes, &factor, &alone);
        let found = [1, 3].map(|threads| {
            let mut answers = vec![Vec::new(); portions.len()];
            let matrices = Matrices(&ground, Mutex::default());
            walk(&ground, &matrices, &portions, &mut answers, &pool(threads)).unwrap();
            let ways = matrices.1.into_inner().unwrap();
            assert!(ways.iter().all(|&count| count > 0), "{ways:?}");
            bits(&answers.concat())
        });
        assert_eq!(found[0], found[1]);
    }

    /// By a slide, by a ring and afresh.
    #[test]
    fn three_ways_lead_to_one_matrix() {
        let factor = Example::new(40, 7, 1).factor();
        let (held, validated, rows) = (windows(40, 3), singletons(40), singletons(40));
        let inner = windows(40, 2);
        let schemes = [scheme(&inner, &validated, None), scheme(&held, &validated, None)];
        let ground = Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None };
        let mut found = Vec::new();
        for (from, ring) in [(10, false), (30, false), (10, true)] {
            let mut work = Workspace::new(40);
            work.start(&ground, 2);
            // The pair of the larger scheme before, then both pairs of this step.
            for (k, pair) in [(1, from), (0, 11), (1, 11)] {
                schemes[k].held.members(pair, &mut work.members[k]);
                work.list(&ground, validated.get(pair), &[k]);
                work.find_change(k);
                work.update_gram(&ground, k, k == 1 && pair == 11 && ring);
            }
            let change = if ring { &work.ring } else { &work.slide };
            // What was added and removed: one at each end, all, and the ring.
            let counts = (change.added.len(), change.removed.len());
            assert_eq!(
                counts,
                if ring {
                    (2, 0)
                } else if from == 10 {
                    (1, 1)
                } else {
                    (7, 0)
                }
            );
            found.push(entries(&work.last[1].gram));
        }
        for gram in &found {
            assert_close(gram, &expected(&factor, held.get(11)), 1e-14);
        }
    }

    #[test]
    fn rows_are_listed_validated_first_then_ring_after_ring() {
        let factor = Example::new(8, 2, 1).factor();
        // Datum i has rows 2 i and 2 i + 1.
        let rows: Sets = (0..4).map(|i| vec![2 * i, 2 * i + 1]).collect();
        let ground = Ground { factor: &factor, schemes: &[], rows: &rows, hat: None };
        let mut work = Workspace::new(4);
        work.members = vec![vec![0, 2], vec![3, 2, 0], vec![2, 1]];
        assert!(work.list(&ground, &[2], &[0, 1]));
        assert_eq!((&work.rows[..], work.validated), (&[4, 5, 0, 1, 6, 7][..], 2));
        assert_eq!(work.ends, [4, 6]);
        assert!(!work.list(&ground, &[2], &[1, 2]));
    }

    /// The one scheme holds out less around some data, the other around the rest; pairs solved together are not asked again.
    #[test]
    fn at_every_step_pairs_are_in_the_order_of_their_own_sizes() {
        #[derive(Default)]
        struct Orders(Mutex<(Vec<Vec<usize>>, Vec<usize>)>);
        impl Question for Orders {
            type Answer = ();

            fn together(&self, _: &mut Workspace, _: Visit<'_>, order: &[usize], (): &mut ()) -> usize {
                self.0.lock().unwrap().0.push(order.to_vec());
                1
            }

            fn dual(&self, _: &mut Workspace, at: Visit<'_>, _: f64, (): &mut ()) -> bool {
                self.0.lock().unwrap().1.push(at.k);
                true
            }

            fn primal(&self, _: &mut Workspace, _: Visit<'_>, _: &Pool<'_>, (): &mut ()) {}
        }
        let (factor, alone) = (Example::new(4, 2, 1).factor(), singletons(4));
        let one = sets([&[0, 1], &[1, 0, 2], &[2, 3], &[3]]);
        let other = sets([&[0, 1, 2], &[1, 2], &[2, 3], &[3, 2]]);
        let schemes = [scheme(&one, &alone, None), scheme(&other, &alone, None)];
        let ground = Ground { factor: &factor, schemes: &schemes, rows: &alone, hat: None };
        let chain = Chain { schemes: vec![0, 1], order: None, length: 4 };
        let orders = Orders::default();
        walk(&ground, &orders, &[Portion { chain: &chain, steps: 0..4 }], &mut [()], &pool(1)).unwrap();
        let (orders, asked) = orders.0.into_inner().unwrap();
        assert_eq!(orders, [[0, 1], [1, 0], [0, 1], [0, 1]]);
        assert_eq!(asked, [1, 0, 1, 1]);
    }

    /// Pairs that hold out the same share the factor.
    #[test]
    fn a_factor_is_known_until_its_matrix_changes() {
        struct Known(Mutex<Vec<bool>>);
        impl Question for Known {
            type Answer = Vec<f64>;

            fn dual(&self, _: &mut Workspace, _: Visit<'_>, _: f64, _: &mut Vec<f64>) -> bool {
                false
            }

            fn primal(&self, work: &mut Workspace, at: Visit<'_>, _: &Pool<'_>, answer: &mut Vec<f64>) {
                let factor = Example::new(12, 3, 1).factor();
                let known = work.known_least(at.k);
                self.0.lock().unwrap().push(known.is_some());
                let again = work.factor_primal(&factor, at.k, 0);
                assert!(known.is_none_or(|least| least == again));
                assert!(work.known_least(at.k + 1).is_none());
                answer.push(again);
            }
        }
        let factor = Example::new(12, 3, 1).factor();
        let held = sets([&[0, 1, 2], &[1, 0, 2], &[0, 1, 3], &[0, 1, 3]]);
        let validated = sets([&[0], &[1], &[0], &[3]]);
        let (schemes, rows) = ([scheme(&held, &validated, None)], singletons(12));
        let ground = Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None };
        let chain = Chain { schemes: vec![0], order: None, length: 4 };
        let known = Known(Mutex::default());
        walk(&ground, &known, &[Portion { chain: &chain, steps: 0..4 }], &mut [Vec::new()], &pool(1))
            .unwrap();
        assert_eq!(known.0.into_inner().unwrap(), [false, true, false, true]);
    }
}
