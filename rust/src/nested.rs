//! Every leading model at once: model l has the first l columns of the design.
//!
//! Let Q be the basis of an unpivoted factorisation, so that its first l columns span those of model l. For a held-out set K
//! factor `M = I - Q_K^T Q_K = L L^T` without pivoting. With `u = L^-1 q_i` and `v = L^-1 (Q^T b - Q_K^T b_K)`, the prediction
//! of model l at row i is
//!
//! ```text
//! sum_{j <= l} u_j v_j
//! ```
//!
//! since leading blocks of L factor leading blocks of M: the whole curve over l costs one factorisation a set.
//!
//! * **Dual**, for small sets: `S_l = I - Q_K,l Q_K,l^T` loses one rank-one term a column. With `w = S_l-1^-1 q_l` and
//!   `d = 1 - q_l . w`, which is the pivot `L_ll^2`,
//!   `S_l^-1 = S_l-1^-1 + w w^T / d` and the prediction residuals become `e - w (c_l - q_l . e) / d`. The sums have no
//!   cancellation; what drifts shows in `S_p e - e_K`, and is then left to the primal.
//! * **Neighbouring sets** share a [`Gram`] matrix: that of a pair is made from that of the pair before, of the next smaller
//!   scheme around the same datum (ring by ring), or afresh, whichever differs in the fewest rows.
//! * **Rank loss.** A vanishing pivot at column j leaves models j, j + 1, .. undefined. Pairs near it are refitted from
//!   their training rows, whose own triangle gives u and v for all l.

use std::sync::OnceLock;

use crate::cholesky::Bordered;
use crate::error::Error;
use crate::factor::{self, Factor, Problem, expect_length};
use crate::gram::Gram;
use crate::holdout::{PROBES, check_indices, least_eigenvalue, sign};
use crate::linalg::dot;
use crate::pool::Pool;
use crate::refit::Refit;
use crate::scheme::Sets;

/// Below this lambda_min(M) pairs are refitted. The closed form's error, about eps / lambda_min(M), is there that of any
/// refit of noisy data, whose condition is the same.
const SAFE: f64 = 1e-7;

/// Below this lambda_min(M), training rows of an ill-conditioned design may have lost rank.
const DOUBTFUL: f64 = 1e-5;

/// Residual of the dual's last system, relative to its terms, that tells of drift.
const DRIFT: f64 = 1e-11;

/// Steps of a chain that share matrices; the next ones start afresh, so that rounding does not grow.
const STEPS: usize = 64;

/// Multiply-adds of a task, so that none delays an interrupt.
const TASK: f64 = 1e9;

/// Validated rows solved for together.
const CARRIED: usize = 64;

/// Held-out and validated data of every pair, and an order in which successive pairs share most of what they hold out.
pub struct Scheme<'a> {
    /// Held-out data of each pair, increasing.
    pub held: &'a Sets,
    /// Validated data of each pair, a subset of those held out.
    pub validated: &'a Sets,
    /// A permutation of the pairs.
    pub order: &'a [usize],
}

/// What a scheme says of every model.
pub struct Curve {
    /// Sum of squared weighted prediction residuals, one a model; NaN where a pair is undefined.
    pub squares: Vec<f64>,
    /// By pair, how many of the models are defined.
    pub defined: Vec<usize>,
}

/// The fit of one model.
pub struct Fit {
    /// Sum of squared weighted residuals.
    pub squares: f64,
    /// Trace of the hat matrix: the effective number of parameters.
    pub parameters: f64,
    /// Number of columns that add rank.
    pub rank: usize,
}

/// A factored problem whose leading columns are models of their own.
pub struct Nested {
    factor: Factor,
    /// The columns that add rank to those before; all of them as a rule.
    kept: Vec<usize>,
    /// The problem without the others, if there are others.
    reduced: Option<(Vec<f64>, Vec<f64>)>,
    /// Weighted responses, rows x responses.
    right: Vec<f64>,
    /// `Q^T b`, responses x rank.
    projection: Vec<f64>,
}

impl Nested {
    /// Factors all models.
    pub fn new(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let mut factor = Factor::new(problem, pool)?;
        let mut kept: Vec<usize> = (0..problem.columns).collect();
        let mut reduced = None;
        if factor.rank < problem.columns {
            kept = factor.independent_columns(pool)?;
            let parts = (
                columns(problem.design, problem.columns, &kept),
                columns(problem.penalty, problem.columns, &kept),
            );
            factor = Factor::new(&part(problem, &parts, kept.len()), pool)?;
            reduced = Some(parts);
        }
        let right = factor::weighted_responses(problem, factor.responses);
        let projection = factor.project(&right, pool)?;
        Ok(Self { factor, kept, reduced, right, projection })
    }

    /// How many of the independent columns are among the first ones of the design.
    fn cuts(&self, sizes: &[usize]) -> Result<Vec<usize>, Error> {
        if let Some(index) = (1..sizes.len()).find(|&k| sizes[k] < sizes[k - 1]) {
            return Err(Error::Decreasing { index });
        }
        Ok(sizes.iter().map(|&size| self.kept.partition_point(|&column| column < size)).collect())
    }

    /// The fit of the models with these numbers of columns.
    pub fn fits(&self, sizes: &[usize], pool: &Pool<'_>) -> Result<Vec<Fit>, Error> {
        const ROWS: usize = 2000;
        let Factor { rank, rows, .. } = self.factor;
        let cuts = self.cuts(sizes)?;
        let width = rank + sizes.len();
        let mut parts = vec![0.0; rows.div_ceil(ROWS) * width];
        pool.run(
            parts.chunks_exact_mut(width.max(1)).enumerate(),
            || (),
            |(), (block, part)| {
                let (leverage, squares) = part.split_at_mut(rank);
                for i in block * ROWS..rows.min((block + 1) * ROWS) {
                    let q = self.factor.basis_row(i);
                    leverage.iter_mut().zip(q).for_each(|(h, q)| *h += q * q);
                    for (b, c) in self.right_row(i).iter().zip(self.projection.chunks_exact(rank)) {
                        curve(*b, q, c, &cuts, squares);
                    }
                }
            },
        )?;
        let mut sums = vec![0.0; width];
        for part in parts.chunks_exact(width.max(1)) {
            sums.iter_mut().zip(part).for_each(|(s, x)| *s += x);
        }
        let (leverage, squares) = sums.split_at(rank);
        let fit = |(&cut, &squares): (&usize, &f64)| Fit {
            squares,
            parameters: leverage[..cut].iter().sum(),
            rank: cut,
        };
        Ok(cuts.iter().zip(squares).map(fit).collect())
    }

    /// Cross-validates the models with these numbers of columns, increasing, by every scheme. Schemes with equal validated
    /// sets and order go through the data together, the smaller first.
    pub fn curves(
        &self,
        problem: &Problem<'_>,
        schemes: &[Scheme<'_>],
        rows: &Sets,
        sizes: &[usize],
        pool: &Pool<'_>,
    ) -> Result<Vec<Curve>, Error> {
        check(schemes, rows, self.factor.rows)?;
        let cuts = self.cuts(sizes)?;
        let sweep = Sweep { nested: self, schemes, rows, cuts: &cuts };
        let chains = chains(schemes);
        let mut tasks: Vec<Task> = Vec::new();
        for chain in &chains {
            let length = schemes[chain[0]].order.len();
            let steps = sweep.steps(chain);
            tasks.extend(
                (0..length).step_by(steps).map(|first| sweep.task(chain, first, length.min(first + steps))),
            );
        }
        pool.run(
            tasks.iter_mut(),
            || Workspace::new(&sweep),
            |workspace, task| workspace.walk(&sweep, task),
        )?;
        let mut found: Vec<Curve> = schemes
            .iter()
            .map(|s| Curve { squares: vec![0.0; cuts.len()], defined: vec![cuts.len(); s.held.len()] })
            .collect();
        let mut rest = Vec::new();
        for task in &tasks {
            for (&s, squares) in task.chain.iter().zip(task.squares.chunks_exact(cuts.len().max(1))) {
                found[s].squares.iter_mut().zip(squares).for_each(|(sum, x)| *sum += x);
            }
            rest.extend_from_slice(&task.doubtful);
        }
        sweep.rescue(problem, &rest, &mut found, pool)?;
        Ok(found)
    }

    fn right_row(&self, i: usize) -> &[f64] {
        let r = self.factor.responses;
        &self.right[i * r..(i + 1) * r]
    }

    /// The problem that was factored, of the one that came.
    fn independent<'a>(&'a self, problem: &'a Problem<'a>) -> Problem<'a> {
        match &self.reduced {
            Some(parts) => part(problem, parts, self.kept.len()),
            None => Problem { ..*problem },
        }
    }
}

fn columns(matrix: &[f64], width: usize, kept: &[usize]) -> Vec<f64> {
    matrix.chunks_exact(width).flat_map(|row| kept.iter().map(|&j| row[j])).collect()
}

fn part<'a>(
    problem: &Problem<'a>,
    (design, penalty): &'a (Vec<f64>, Vec<f64>),
    columns: usize,
) -> Problem<'a> {
    Problem { design, penalty, columns, ..*problem }
}

/// Adds the squared residuals of one right-hand side at every cut: `(b - sum_{j < cut} u_j v_j)^2`.
fn curve(b: f64, u: &[f64], v: &[f64], cuts: &[usize], squares: &mut [f64]) {
    let (mut rest, mut done) = (b, 0);
    for (square, &cut) in squares.iter_mut().zip(cuts) {
        for (u, v) in u[done..cut].iter().zip(&v[done..cut]) {
            rest -= u * v;
        }
        done = cut;
        *square += rest * rest;
    }
}

fn check(schemes: &[Scheme<'_>], rows: &Sets, bound: usize) -> Result<(), Error> {
    check_indices(rows, bound)?;
    for scheme in schemes {
        check_indices(scheme.held, rows.len())?;
        check_indices(scheme.validated, rows.len())?;
        expect_length(scheme.validated.len(), scheme.held.len())?;
        expect_length(scheme.order.len(), scheme.held.len())?;
        if let Some(&index) = scheme.order.iter().find(|&&pair| pair >= scheme.held.len()) {
            return Err(Error::Index { index, bound: scheme.held.len() });
        }
    }
    Ok(())
}

/// Schemes around the same data, those that hold out less first.
fn chains(schemes: &[Scheme<'_>]) -> Vec<Vec<usize>> {
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
        chain.sort_by_key(|&s| schemes[s].held.items.len());
    }
    chains
}

/// Steps of a chain, and what they found.
struct Task<'a> {
    chain: &'a [usize],
    steps: std::ops::Range<usize>,
    /// Chain x cuts.
    squares: Vec<f64>,
    /// Scheme and pair of those too close to rank loss.
    doubtful: Vec<(usize, usize)>,
}

/// What all tasks read.
struct Sweep<'a> {
    nested: &'a Nested,
    schemes: &'a [Scheme<'a>],
    rows: &'a Sets,
    cuts: &'a [usize],
}

impl Sweep<'_> {
    /// How many steps of a chain make a task: enough to share, not so many that threads idle or an interrupt waits. It depends
    /// on the problem alone, and so do the results.
    fn steps(&self, chain: &[usize]) -> usize {
        let p = self.nested.factor.rank as f64;
        let length = self.schemes[chain[0]].order.len().max(1);
        let cost: f64 = chain
            .iter()
            .map(|&s| p * p * (p / 6.0 + self.schemes[s].held.items.len() as f64 / length as f64 / 4.0))
            .sum();
        let most = (TASK / cost.max(1.0)) as usize;
        (length / 32).clamp(8, STEPS).min(most).max(1)
    }

    fn task<'a>(&self, chain: &'a [usize], first: usize, last: usize) -> Task<'a> {
        Task {
            chain,
            steps: first..last,
            squares: vec![0.0; chain.len() * self.cuts.len()],
            doubtful: Vec::new(),
        }
    }

    /// Refits the pairs that the closed form left, each a task of its own: they cost far more than the others.
    fn rescue(
        &self,
        problem: &Problem<'_>,
        pairs: &[(usize, usize)],
        found: &mut [Curve],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let problem = self.nested.independent(problem);
        let mut results: Vec<(Vec<f64>, usize)> = vec![(Vec::new(), 0); pairs.len()];
        let failure = OnceLock::new();
        pool.run(
            pairs.iter().zip(&mut results),
            || (Workspace::new(self), Refit::default()),
            |(workspace, refit), (&(s, pair), result)| match workspace.refit(
                self,
                &problem,
                refit,
                (s, pair),
                pool,
            ) {
                Ok(defined) => *result = (workspace.curve.clone(), defined),
                Err(error) => drop(failure.set(error)),
            },
        )?;
        for (&(s, pair), (squares, defined)) in pairs.iter().zip(&results) {
            found[s].defined[pair] = *defined;
            found[s].squares.iter_mut().zip(squares).for_each(|(sum, x)| *sum += x);
        }
        failure.into_inner().map_or(Ok(()), Err)
    }
}

/// The matrix of one scheme's last pair, and whose rows it left out.
#[derive(Default)]
struct Held {
    gram: Gram,
    members: Vec<usize>,
    /// By datum, whether it is one of the members.
    inside: Vec<bool>,
}

/// How one set of data becomes another.
#[derive(Default)]
struct Change {
    added: Vec<usize>,
    removed: Vec<usize>,
}

impl Change {
    fn len(&self) -> usize {
        self.added.len() + self.removed.len()
    }

    /// From the members of `held` to those that bear the stamp `now`.
    fn find(&mut self, held: &Held, members: &[usize], stamps: &[u32], now: u32) {
        self.added.clear();
        self.added.extend(members.iter().filter(|&&datum| !held.inside[datum]));
        self.removed.clear();
        self.removed.extend(held.members.iter().filter(|&&datum| stamps[datum] != now));
    }
}

/// Everything a thread needs to solve pairs without allocating.
struct Workspace {
    system: Bordered,
    /// One a scheme of the chain, and last an empty one.
    held: Vec<Held>,
    stamps: Vec<u32>,
    now: u32,
    slide: Change,
    ring: Change,
    /// Held-out rows of the pair at hand, the validated ones last.
    rows: Vec<usize>,
    validated: usize,
    /// Squared prediction residuals of the pair at hand, one a cut.
    curve: Vec<f64>,
    forward: Vec<f64>,
    dual: Dual,
}

impl Workspace {
    fn new(sweep: &Sweep<'_>) -> Self {
        Self {
            system: Bordered::default(),
            held: Vec::new(),
            stamps: vec![0; sweep.rows.len()],
            now: 0,
            slide: Change::default(),
            ring: Change::default(),
            rows: Vec::new(),
            validated: 0,
            curve: vec![0.0; sweep.cuts.len()],
            forward: Vec::new(),
            dual: Dual::default(),
        }
    }

    /// Goes through the steps of a task, all schemes of the chain at each.
    fn walk(&mut self, sweep: &Sweep<'_>, task: &mut Task<'_>) {
        self.forget(sweep, task.chain.len());
        for step in task.steps.clone() {
            for (k, &s) in task.chain.iter().enumerate() {
                let pair = sweep.schemes[s].order[step];
                if self.solve(sweep, (s, pair), k) {
                    let squares = &mut task.squares[k * self.curve.len()..(k + 1) * self.curve.len()];
                    squares.iter_mut().zip(&self.curve).for_each(|(sum, x)| *sum += x);
                } else {
                    task.doubtful.push((s, pair));
                }
            }
        }
    }

    /// Starts afresh: nothing is held out.
    fn forget(&mut self, sweep: &Sweep<'_>, schemes: usize) {
        let Factor { rank, .. } = sweep.nested.factor;
        self.held.resize_with(schemes.max(self.held.len()), Held::default);
        for held in &mut self.held[..schemes] {
            held.members.clear();
            held.inside.clear();
            held.inside.resize(sweep.rows.len(), false);
            held.gram.start(rank, &sweep.nested.projection);
        }
    }

    fn gather(&mut self, sweep: &Sweep<'_>, (s, pair): (usize, usize)) {
        let scheme = &sweep.schemes[s];
        let validated = scheme.validated.get(pair);
        self.rows.clear();
        let mut skip = validated.iter().peekable();
        for &datum in scheme.held.get(pair) {
            if skip.next_if_eq(&&datum).is_none() {
                self.rows.extend_from_slice(sweep.rows.get(datum));
            }
        }
        let others = self.rows.len();
        for &datum in validated {
            self.rows.extend_from_slice(sweep.rows.get(datum));
        }
        self.validated = self.rows.len() - others;
    }

    /// Fills the curve of a pair, the k-th of its chain; false if the pair is too close to rank loss.
    fn solve(&mut self, sweep: &Sweep<'_>, pair: (usize, usize), k: usize) -> bool {
        let Nested { factor, .. } = sweep.nested;
        self.gather(sweep, pair);
        self.curve.fill(0.0);
        if self.validated == 0 {
            return factor.total_rows >= factor.rank + self.rows.len();
        }
        if factor.total_rows < factor.rank + self.rows.len() {
            return false;
        }
        let members = sweep.schemes[pair.0].held.get(pair.1);
        self.now += 1;
        members.iter().for_each(|&datum| self.stamps[datum] = self.now);
        self.slide.find(&self.held[k], members, &self.stamps, self.now);
        let ring = k > 0 && {
            self.ring.find(&self.held[k - 1], members, &self.stamps, self.now);
            self.ring.len() < self.slide.len()
        };
        let (q, p) = (self.rows.len() as f64, factor.rank as f64);
        let changed =
            self.slide.len().min(if ring { self.ring.len() } else { usize::MAX }).min(members.len());
        let rows = changed as f64 * q / members.len() as f64;
        if 4.0 * q * q * p <= p * p * (p / 6.0 + rows / 2.0 + 1.0)
            && self.dual.solve(sweep.nested, sweep.cuts, (&self.rows, self.validated), &mut self.curve)
        {
            return true;
        }
        self.curve.fill(0.0);
        self.follow(sweep, members, k, ring);
        self.primal(sweep, k)
    }

    /// Turns the k-th matrix into that of these members, from the nearest that is known.
    fn follow(&mut self, sweep: &Sweep<'_>, members: &[usize], k: usize, ring: bool) {
        let Nested { factor, projection, .. } = sweep.nested;
        let (before, rest) = self.held.split_at_mut(k);
        let held = &mut rest[0];
        let mut change = if ring { &mut self.ring } else { &mut self.slide };
        if change.len() > members.len() {
            held.gram.start(factor.rank, projection);
            change = &mut self.slide;
            change.removed.clear();
            change.added.clear();
            change.added.extend_from_slice(members);
        } else if ring {
            held.gram.copy_from(&before[k - 1].gram);
        }
        let fetch = |i: usize| (factor.basis_row(i), sweep.nested.right_row(i));
        let rows = |data: &[usize]| -> Vec<usize> {
            data.iter().flat_map(|&d| sweep.rows.get(d)).copied().collect()
        };
        held.gram.remove(&rows(&change.added), fetch);
        held.gram.restore(&rows(&change.removed), fetch);
        held.members.iter().for_each(|&datum| held.inside[datum] = false);
        members.iter().for_each(|&datum| held.inside[datum] = true);
        held.members.clear();
        held.members.extend_from_slice(members);
    }

    fn primal(&mut self, sweep: &Sweep<'_>, k: usize) -> bool {
        let Nested { factor, .. } = sweep.nested;
        let (rank, responses) = (factor.rank, factor.responses);
        self.system.start_from(&self.held[k].gram, PROBES);
        for probe in 0..PROBES {
            for j in 0..rank {
                *self.system.entry(rank + responses + probe, j) = sign(probe, j);
            }
        }
        let certain =
            factor.least * (SAFE / 100.0).sqrt() > factor.tolerance * (factor.columns as f64).sqrt();
        if least_eigenvalue(&mut self.system, rank, responses) < if certain { SAFE } else { DOUBTFUL } {
            return false;
        }
        let Self { system, rows, validated, curve, forward, .. } = self;
        for rows in rows[rows.len() - *validated..].chunks(CARRIED) {
            for c in 0..responses {
                system.forward_row(c, forward);
                let carried = system.carry(rows.iter().map(|&i| factor.basis_row(i)));
                for (panel, rows) in carried.chunks_exact(rank).zip(rows.chunks(8)) {
                    let b = std::array::from_fn(|lane| {
                        rows.get(lane).map_or(0.0, |&i| sweep.nested.right_row(i)[c])
                    });
                    curves(b, panel, forward, sweep.cuts, curve);
                }
            }
        }
        true
    }

    /// Fills the curve of a pair from its training rows, and tells how many of the models are defined.
    fn refit(
        &mut self,
        sweep: &Sweep<'_>,
        problem: &Problem<'_>,
        refit: &mut Refit,
        pair: (usize, usize),
        pool: &Pool<'_>,
    ) -> Result<usize, Error> {
        let Nested { factor, .. } = sweep.nested;
        self.gather(sweep, pair);
        let leading = refit.lead(factor, problem, pool, &self.rows)?;
        let defined = sweep.cuts.partition_point(|&cut| cut <= leading);
        self.curve[..defined].fill(0.0);
        self.curve[defined..].fill(f64::NAN);
        for &i in &self.rows[self.rows.len() - self.validated..] {
            for c in 0..factor.responses {
                let (b, u, v) = refit.forward(factor, problem, i, c, leading)?;
                curve(b, u, v, &sweep.cuts[..defined], &mut self.curve);
            }
        }
        Ok(defined)
    }
}

/// As [`curve`], for eight rows side by side.
fn curves(b: [f64; 8], u: &[[f64; 8]], v: &[f64], cuts: &[usize], squares: &mut [f64]) {
    let (mut rest, mut done) = (b, 0);
    for (square, &cut) in squares.iter_mut().zip(cuts) {
        for (u, v) in u[done..cut].iter().zip(&v[done..cut]) {
            for (rest, u) in rest.iter_mut().zip(u) {
                *rest -= u * v;
            }
        }
        done = cut;
        *square += dot(&rest, &rest);
    }
}

/// Workspace of the dual.
#[derive(Default)]
struct Dual {
    /// Q_K, column by column.
    columns: Vec<f64>,
    /// `S_l^-1`, q x q.
    inverse: Vec<f64>,
    /// Prediction residuals of model l, responses x q.
    residuals: Vec<f64>,
    w: Vec<f64>,
}

impl Dual {
    /// Adds the squared residuals of the last `validated` rows at every cut; false if that may be inaccurate.
    fn solve(
        &mut self,
        nested: &Nested,
        cuts: &[usize],
        (rows, validated): (&[usize], usize),
        squares: &mut [f64],
    ) -> bool {
        let (q, rank) = (rows.len(), nested.factor.rank);
        self.load(nested, rows);
        let first = q - validated;
        let mut done = 0;
        for (square, &cut) in squares.iter_mut().zip(cuts) {
            if !(done..cut).all(|j| self.column(j, q, nested.projection.chunks_exact(rank))) {
                return false;
            }
            done = cut;
            *square += self.residuals.chunks_exact(q).map(|e| dot(&e[first..], &e[first..])).sum::<f64>();
        }
        let trace: f64 = self.inverse.iter().step_by(q + 1).sum();
        trace < q as f64 + 1.0 / DOUBTFUL && !self.drifted(nested, rows, done)
    }

    fn load(&mut self, nested: &Nested, rows: &[usize]) {
        let (q, rank, responses) = (rows.len(), nested.factor.rank, nested.factor.responses);
        self.columns.resize(q * rank, 0.0);
        self.residuals.resize(q * responses, 0.0);
        self.w.resize(q, 0.0);
        self.inverse.clear();
        self.inverse.resize(q * q, 0.0);
        for (k, &row) in rows.iter().enumerate() {
            self.inverse[k * (q + 1)] = 1.0;
            self.columns[k..]
                .iter_mut()
                .step_by(q)
                .zip(nested.factor.basis_row(row))
                .for_each(|(x, q)| *x = *q);
            self.residuals[k..].iter_mut().step_by(q).zip(nested.right_row(row)).for_each(|(e, b)| *e = *b);
        }
    }

    /// Adds column j to the model; false if its pivot vanishes.
    fn column<'a>(&mut self, j: usize, q: usize, projection: impl Iterator<Item = &'a [f64]>) -> bool {
        let Self { columns, inverse, residuals, w } = self;
        let column = &columns[j * q..(j + 1) * q];
        for (w, row) in w.iter_mut().zip(inverse.chunks_exact(q)) {
            *w = dot(row, column);
        }
        let pivot = 1.0 - dot(w, column);
        if pivot.is_nan() || pivot <= DOUBTFUL {
            return false;
        }
        for (e, c) in residuals.chunks_exact_mut(q).zip(projection) {
            let step = (c[j] - dot(column, e)) / pivot;
            e.iter_mut().zip(&*w).for_each(|(e, w)| *e -= w * step);
        }
        for (row, w_row) in inverse.chunks_exact_mut(q).zip(&*w) {
            let factor = w_row / pivot;
            row.iter_mut().zip(&*w).for_each(|(x, w)| *x += factor * w);
        }
        true
    }

    /// Whether `S e` is not what it must be, e_K of the last model: a direct check of all the updates.
    fn drifted(&self, nested: &Nested, rows: &[usize], rank: usize) -> bool {
        let q = rows.len();
        let projections = nested.projection.chunks_exact(nested.factor.rank);
        self.residuals.chunks_exact(q).zip(projections).enumerate().any(|(c, (e, projection))| {
            let turned: Vec<f64> =
                self.columns.chunks_exact(q).take(rank).map(|column| dot(column, e)).collect();
            rows.iter().zip(e).any(|(&row, e_row)| {
                let basis = &nested.factor.basis_row(row)[..rank];
                let b = nested.right_row(row)[c];
                let (back, fit) = (dot(basis, &turned), dot(basis, projection));
                let size = e_row.abs() + back.abs() + b.abs() + fit.abs();
                (e_row - back - (b - fit)).abs() > DRIFT * size
            })
        })
    }
}
