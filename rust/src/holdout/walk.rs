//! The walk along pairs: each pair's matrix is made from the most similar one known.
//!
//! At a step all pairs of a chain are solved, those that hold out less first. What is asked of them, the residuals of one
//! model or the scores of all leading ones, is the [`Question`].

use std::ops::Range;

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

    /// Solves the first pairs of a step together, in the dual, and tells how many.
    fn together(&self, _: &mut Workspace, _: Visit<'_>, _: &mut Self::Answer) -> usize {
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
            last.gram.start(ground.factor.rank, ground.factor.responses);
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
        for k in question.together(self, at, answer)..at.chain.schemes.len() {
            let at = Visit { k, ..at };
            self.list(ground, ground.validated(at), k..k + 1);
            let inner = self.find_change(k);
            let changed = if inner { &self.ring } else { &self.slide }.len().min(self.members[k].len());
            let rows = changed as f64 * self.rows.len() as f64 / self.members[k].len().max(1) as f64;
            let p = ground.factor.rank as f64;
            if !question.dual(self, at, p * p * (rows / 2.0 + p / 6.0), answer) {
                if changed > 0 || inner {
                    self.update_gram(ground, k, inner);
                    self.factored = None;
                }
                question.primal(self, at, pool, answer);
            }
        }
    }

    /// Lists the rows of pairs that validate the same data. False if they do not nest.
    pub(super) fn list(&mut self, ground: &Ground<'_>, validated: &[usize], pairs: Range<usize>) -> bool {
        let Self { rows, stamps, members, ends, .. } = self;
        self.now += 1;
        rows.clear();
        ends.clear();
        let mut listed = 0;
        let mut add = |rows: &mut Vec<usize>, datum: usize| {
            if stamps[datum] != self.now {
                stamps[datum] = self.now;
                listed += 1;
                rows.extend_from_slice(ground.rows.get(datum));
            }
            listed
        };
        let mut nest = true;
        for &datum in validated {
            add(rows, datum);
        }
        self.validated = rows.len();
        for members in &members[pairs] {
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
        if change.len() > members[k].len() {
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
        self.list(ground, scheme.validated.get(pair), 0..1);
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
