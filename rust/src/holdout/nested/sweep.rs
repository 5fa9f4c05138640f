//! Pairs of schemes around the same data, one after another: each pair's matrix is made from the most similar one known.

use super::dual::Dual;
use super::{Nested, Scheme, add_squares};
use crate::fit::factor::Factor;
use crate::fit::linalg::{self, dot};
use crate::fit::rank::leading_rank;
use crate::holdout::gram::Gram;
use crate::holdout::kernel::Bordered;
use crate::holdout::probes::{PROBES, least_eigenvalue, set_probes, sign};
use crate::pool::Pool;
use crate::sets::Sets;

/// Below this lambda_min(M) a pair needs twice the digits.
const PLAIN_MIN_EIGENVALUE: f64 = 2e-7;

/// Above this lambda_min(M) the training rows have the rank of the design; below, those of an ill-conditioned one may not.
pub(super) const CERTAIN_MIN_EIGENVALUE: f64 = 1e-5;

/// Multiply-adds of a task, so that none delays an interrupt.
const TASK_COST: f64 = 1e9;

/// Validated rows solved for together.
const CARRIED_ROWS: usize = 64;

/// Schemes around the same data, those that hold out less first.
pub(super) fn chains(schemes: &[Scheme<'_>]) -> Vec<Vec<usize>> {
    let mut chains: Vec<Vec<usize>> = Vec::new();
    for (s, scheme) in schemes.iter().enumerate() {
        let alike = |other: &Scheme<'_>| {
            other.validated.offsets == scheme.validated.offsets
                && other.validated.items == scheme.validated.items
                && other.order == scheme.order
        };
        match chains.iter_mut().find(|chain| alike(&schemes[chain[0]])) {
            Some(chain) => chain.push(s),
            None => chains.push(vec![s]),
        }
    }
    for chain in &mut chains {
        chain.sort_by(|&s, &t| schemes[s].held.mean().total_cmp(&schemes[t].held.mean()));
    }
    chains
}

/// Steps of a chain, and what they found.
pub(super) struct Task<'a> {
    pub(super) chain: &'a [usize],
    pub(super) steps: std::ops::Range<usize>,
    /// Chain x cuts.
    pub(super) squares: Vec<f64>,
    /// Scheme, step, and number of defined models where these are not all.
    pub(super) cut: Vec<(usize, usize, usize)>,
    /// Scheme and step of those close to rank loss.
    pub(super) close: Vec<(usize, usize)>,
}

/// For which models the closed form solved a pair.
pub(super) enum Outcome {
    All,
    /// This many models are defined, and no more.
    Leading(usize),
    /// None: too close to rank loss for this arithmetic.
    Close,
}

/// What all tasks read.
pub(super) struct Sweep<'a> {
    pub(super) nested: &'a Nested,
    pub(super) schemes: &'a [Scheme<'a>],
    pub(super) rows: &'a Sets,
    pub(super) cuts: &'a [usize],
}

impl Sweep<'_> {
    /// How many steps of a chain make a task: enough to share matrices, not so many that threads idle or an interrupt
    /// waits. It depends on the problem alone, and so do the results. A step changes about as many rows as there are
    /// data along the rim of its neighbourhood; only the first takes them all.
    pub(super) fn steps(&self, chain: &[usize]) -> usize {
        let p = self.nested.factor.rank as f64;
        let length = self.schemes[chain[0]].order.len().max(1);
        let rim = |mean: f64| mean.min(3.0 * mean.sqrt());
        let coupling = self.nested.factor.rows as f64 / self.rows.len().max(1) as f64;
        let cost = |&s: &usize| p * p * (p / 6.0 + coupling * rim(self.schemes[s].held.mean()) / 2.0);
        let most = (TASK_COST / chain.iter().map(cost).sum::<f64>().max(1.0)) as usize;
        (length / 32).max(8).min(most).max(1)
    }

    pub(super) fn rows_of(&self, data: &[usize]) -> Vec<usize> {
        data.iter().flat_map(|&datum| self.rows.get(datum)).copied().collect()
    }

    pub(super) fn task<'a>(&self, chain: &'a [usize], first: usize, last: usize) -> Task<'a> {
        Task {
            chain,
            steps: first..last,
            squares: vec![0.0; chain.len() * self.cuts.len()],
            cut: Vec::new(),
            close: Vec::new(),
        }
    }
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
        self.members.clear();
        self.inside.clear();
        self.inside.resize(count, false);
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

    /// From the members of `last` to those that bear the stamp `now` or a later one.
    pub(super) fn find<G>(&mut self, last: &LastPair<G>, members: &[usize], stamps: &[u32], now: u32) {
        self.added.clear();
        self.added.extend(members.iter().filter(|&&datum| !last.inside[datum]));
        self.removed.clear();
        self.removed.extend(last.members.iter().filter(|&&datum| stamps[datum] < now));
    }
}

/// Everything a thread needs to solve pairs without allocating.
pub(super) struct Workspace {
    pub(super) system: Bordered,
    /// One a scheme of the chain, and last an empty one.
    pub(super) last: Vec<LastPair<Gram>>,
    /// Data that the pair at hand holds out.
    pub(super) members: Vec<usize>,
    pub(super) stamps: Vec<u32>,
    pub(super) now: u32,
    pub(super) slide: SetChange,
    pub(super) ring: SetChange,
    /// Held-out rows of the pair at hand, the validated ones last.
    pub(super) rows: Vec<usize>,
    pub(super) validated: usize,
    /// Squared prediction residuals of the pair at hand, one a cut.
    pub(super) curve: Vec<f64>,
    pub(super) forward: Vec<f64>,
    pub(super) dual: Dual,
}

impl Workspace {
    pub(super) fn new(sweep: &Sweep<'_>) -> Self {
        Self {
            system: Bordered::default(),
            last: Vec::new(),
            members: Vec::new(),
            stamps: vec![0; sweep.rows.len()],
            now: 0,
            slide: SetChange::default(),
            ring: SetChange::default(),
            rows: Vec::new(),
            validated: 0,
            curve: vec![0.0; sweep.cuts.len()],
            forward: Vec::new(),
            dual: Dual::default(),
        }
    }

    /// Solves the steps of a task, all schemes of the chain at each.
    pub(super) fn solve_task(&mut self, sweep: &Sweep<'_>, task: &mut Task<'_>, pool: &Pool<'_>) {
        self.reset(sweep, task.chain.len());
        for step in task.steps.clone() {
            for (k, &s) in task.chain.iter().enumerate() {
                let pair = sweep.schemes[s].order[step];
                let outcome = self.solve(sweep, (s, pair), k, pool);
                let squares = &mut task.squares[k * self.curve.len()..(k + 1) * self.curve.len()];
                if let Outcome::All | Outcome::Leading(_) = outcome {
                    squares.iter_mut().zip(&self.curve).for_each(|(sum, x)| *sum += x);
                }
                match outcome {
                    Outcome::All => {}
                    Outcome::Leading(defined) => task.cut.push((s, step, defined)),
                    Outcome::Close => task.close.push((s, step)),
                }
            }
        }
    }

    /// Starts afresh: nothing is held out.
    fn reset(&mut self, sweep: &Sweep<'_>, schemes: usize) {
        let Factor { rank, responses, .. } = sweep.nested.factor;
        self.last.resize_with(schemes.max(self.last.len()), LastPair::default);
        for last in &mut self.last[..schemes] {
            last.clear(sweep.rows.len());
            last.gram.start(rank, responses);
        }
    }

    /// Lists what a pair holds out, and stamps it: validated data with a later stamp.
    pub(super) fn list_rows(&mut self, sweep: &Sweep<'_>, (s, pair): (usize, usize)) {
        let Scheme { held, validated, .. } = &sweep.schemes[s];
        let validated = validated.get(pair);
        held.members(pair, &mut self.members);
        self.now += 2;
        self.members.iter().for_each(|&datum| self.stamps[datum] = self.now);
        validated.iter().for_each(|&datum| self.stamps[datum] = self.now + 1);
        let others = self.members.iter().filter(|&&datum| self.stamps[datum] == self.now);
        self.rows.clear();
        self.rows.extend(others.flat_map(|&datum| sweep.rows.get(datum)));
        let others = self.rows.len();
        self.rows.extend(validated.iter().flat_map(|&datum| sweep.rows.get(datum)));
        self.validated = self.rows.len() - others;
    }

    /// Fills the curve of a pair, the k-th of its chain.
    fn solve(&mut self, sweep: &Sweep<'_>, pair: (usize, usize), k: usize, pool: &Pool<'_>) -> Outcome {
        let Nested { factor, .. } = sweep.nested;
        self.list_rows(sweep, pair);
        self.curve.fill(0.0);
        if self.rows.is_empty() {
            return Outcome::All;
        }
        if factor.total_rows < factor.rank + self.rows.len() {
            return Outcome::Close;
        }
        let Self { members, stamps, now, last, slide, ring, .. } = self;
        slide.find(&last[k], members, stamps, *now);
        let inner = k > 0 && {
            ring.find(&last[k - 1], members, stamps, *now);
            ring.len() < slide.len()
        };
        let changed = if inner { ring.len() } else { slide.len() }.min(members.len());
        let (q, p) = (self.rows.len() as f64, factor.rank as f64);
        let rows = changed as f64 * q / members.len() as f64;
        if 4.0 * q * q * p <= p * p * (p / 6.0 + rows / 2.0 + 1.0)
            && self.dual.solve(sweep.nested, sweep.cuts, (&self.rows, self.validated), &mut self.curve)
        {
            return Outcome::All;
        }
        self.curve.fill(0.0);
        self.update_gram(sweep, k, inner);
        self.primal(sweep, k, pool)
    }

    /// Turns the k-th matrix into that of the current pair, starting from the most similar one known.
    fn update_gram(&mut self, sweep: &Sweep<'_>, k: usize, inner: bool) {
        let Nested { factor, .. } = sweep.nested;
        let Self { last, members, slide, ring, .. } = self;
        let (before, rest) = last.split_at_mut(k);
        let last = &mut rest[0];
        let change = if inner { ring } else { slide };
        if change.len() > members.len() {
            last.gram.start(factor.rank, factor.responses);
            change.removed.clear();
            change.added.clone_from(members);
        } else if inner {
            last.gram.copy_from(&before[k - 1].gram);
        }
        let fetch = |i: usize| (factor.basis_row(i), factor.residual_row(i));
        last.gram.change(&sweep.rows_of(&change.added), -1.0, fetch);
        last.gram.change(&sweep.rows_of(&change.removed), 1.0, fetch);
        last.set_members(members);
    }

    fn primal(&mut self, sweep: &Sweep<'_>, k: usize, pool: &Pool<'_>) -> Outcome {
        let Nested { factor, .. } = sweep.nested;
        let (rank, responses) = (factor.rank, factor.responses);
        self.system.start_from(&self.last[k].gram, PROBES);
        set_probes(&mut self.system, rank, responses);
        let least = least_eigenvalue(&mut self.system, rank, responses);
        if least < PLAIN_MIN_EIGENVALUE {
            return Outcome::Close;
        }
        let Self { system, rows, validated, curve, forward, .. } = self;
        for rows in rows[rows.len() - *validated..].chunks(CARRIED_ROWS) {
            system.carry(rows.iter().map(|&i| factor.basis_row(i)));
            for c in 0..responses {
                system.forward_row(c, forward);
                system.add_transposed(&factor.projection[c * rank..(c + 1) * rank], forward);
                for (panel, rows) in system.carried().chunks_exact(rank.max(1)).zip(rows.chunks(8)) {
                    let mut b = [0.0; 8];
                    b.iter_mut().zip(rows).for_each(|(b, &i)| *b = sweep.nested.right_row(i)[c]);
                    add_squares(b, panel, forward, sweep.cuts, curve);
                }
            }
        }
        if least > CERTAIN_MIN_EIGENVALUE {
            Outcome::All
        } else {
            self.cut(sweep, &self.system.upper(), pool)
        }
    }

    /// Which models the training rows determine, by their triangle `L^T R`, given L^T.
    pub(super) fn cut(&mut self, sweep: &Sweep<'_>, upper: &[f64], pool: &Pool<'_>) -> Outcome {
        let factor = &sweep.nested.factor;
        let (rank, cuts) = (factor.rank, sweep.cuts);
        let lost = factor.tolerance * (rank as f64).sqrt();
        let safe = (0..PROBES).all(|probe| {
            let mut x: Vec<f64> = (0..rank).map(|j| sign(probe, j)).collect();
            linalg::solve_upper(upper, rank, rank, &mut x, 1);
            linalg::solve_upper(&factor.triangle, rank, rank, &mut x, 1);
            // An estimate of the inverse's norm, give or take a factor of ten.
            10.0 * lost * dot(&x, &x).sqrt() < 1.0
        });
        if safe {
            return Outcome::All;
        }
        let triangle = linalg::product(upper, &factor.triangle, rank, rank, rank);
        match leading_rank(&triangle, rank, factor.tolerance, pool) {
            Ok(count) if count == rank => Outcome::All,
            Ok(count) => {
                let defined = cuts.partition_point(|&cut| cut <= count);
                self.curve[defined..].fill(f64::NAN);
                Outcome::Leading(defined)
            }
            Err(_) => Outcome::Close,
        }
    }
}
