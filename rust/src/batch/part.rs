//! Problems of one shape that a thread takes at once: side by side where that pays and is exact, else one by one.

use pulp::{Arch, Simd, WithSimd};

use crate::batch::lanes::{Fits, Shape, dot};
use crate::batch::pairs::{self, Pair, System};
use crate::batch::{Found, Run};
use crate::error::Error;
use crate::fit::factor::{Factor, Problem};
use crate::holdout::residuals::Status;
use crate::pool::{Pool, take};
use crate::sets::Sets;

/// Multiply-adds that a thread takes at once, and problems, of which vectors hold eight.
const AT_ONCE: usize = 10_000_000;
const MOST_AT_ONCE: usize = 64;

/// Vectors up to which problems side by side stay in a second-level cache of a megabyte.
const MOST_VECTORS: usize = 1 << 14;

/// Data that all pairs hold out in all, beyond which neighbouring pairs had better share their work.
const MOST_HELD: f64 = 1e6;

/// The largest response: residuals, which may exceed the responses, must not overflow.
const LARGEST: f64 = 1e303;

/// Successive problems of a run, and where what is found goes.
pub(super) struct Part<'a> {
    run: (usize, &'a Run<'a>),
    /// The first of them in the run.
    first: usize,
    /// Of all problems, the first of these.
    number: usize,
    coefficients: &'a mut [f64],
    residuals: &'a mut [f64],
    scores: &'a mut [f64],
    fit_rms: &'a mut [f64],
    ranks: &'a mut [usize],
    undefined: Result<Vec<(usize, usize)>, Error>,
}

/// Cuts runs into parts.
pub(super) fn cut<'a>(runs: &'a [Run<'a>], found: &'a mut Found) -> Vec<Part<'a>> {
    let Found { coefficients, residuals, scores, fit_rms, ranks, .. } = found;
    let (mut coefficients, mut residuals, mut scores) =
        (&mut coefficients[..], &mut residuals[..], &mut scores[..]);
    let (mut fit_rms, mut ranks) = (&mut fit_rms[..], &mut ranks[..]);
    let mut parts = Vec::new();
    let mut number = 0;
    for run in runs.iter().enumerate() {
        let (solution, predictions) = (run.1.columns * run.1.width(), run.1.validated() * run.1.width());
        let cost = run.1.rows * run.1.columns * run.1.columns * (1 + run.1.scheme.validated.len() / 64);
        let most = (AT_ONCE / cost.max(1)).next_multiple_of(8).clamp(8, MOST_AT_ONCE);
        for first in (0..run.1.count).step_by(most) {
            let count = most.min(run.1.count - first);
            parts.push(Part {
                run,
                first,
                number,
                coefficients: take(&mut coefficients, count * solution),
                residuals: take(&mut residuals, count * predictions),
                scores: take(&mut scores, count),
                fit_rms: take(&mut fit_rms, count),
                ranks: take(&mut ranks, count),
                undefined: Ok(Vec::new()),
            });
            number += count;
        }
    }
    parts
}

impl Part<'_> {
    /// Undefined pairs, of all problems, or the first error.
    pub fn outcome(self) -> Result<Vec<(usize, usize)>, Error> {
        self.undefined
    }

    /// Fits and cross-validates the problems.
    pub fn solve(&mut self, work: &mut Workspace, pool: &Pool<'_>) {
        let (number, run) = self.run;
        if work.plan.as_ref().is_none_or(|(planned, _)| *planned != number) {
            work.plan = Some((number, Plan::new(run)));
        }
        let alone = match &work.plan {
            Some((_, Some(plan))) => {
                Arch::new().dispatch(SideBySide { part: self, plan, space: &mut work.space })
            }
            _ => (0..self.scores.len()).collect(),
        };
        for k in alone {
            if let Err(error) = self.solve_alone(k, &pool.alone()) {
                self.undefined = Err(error);
                break;
            }
        }
    }

    /// Solves a problem as if there were no other.
    fn solve_alone(&mut self, k: usize, pool: &Pool<'_>) -> Result<(), Error> {
        let run = self.run.1;
        let problem = run.problem(self.first + k);
        let within = |numbers: &[f64], most: f64| numbers.iter().all(|x| x.abs() <= most);
        let weights = problem.root_weights.unwrap_or_default();
        if !(within(problem.design, f64::MAX)
            && within(problem.responses, LARGEST)
            && within(weights, f64::MAX))
        {
            return Err(Error::NotFinite { index: self.number + k });
        }
        let fit = Factor::new(&problem, pool)?;
        let found = fit.predict(&problem, &[run.scheme], run.data, pool)?;
        let lost = (0..found.status.len()).filter(|&pair| found.status[pair] == Status::Undefined);
        let before = self.undefined.as_ref().map_or(0, Vec::len);
        if let Ok(undefined) = &mut self.undefined {
            undefined.extend(lost.map(|pair| (self.number + k, pair)));
            let defined = undefined.len() == before;
            self.scores[k] =
                if defined { fit.score(run.data, run.scheme.validated, &found.residuals) } else { f64::NAN };
        }
        self.fit_rms[k] = fit.fit_rms(run.data);
        self.ranks[k] = fit.rank;
        place(self.coefficients, k, fit.coefficients.len()).copy_from_slice(&fit.coefficients);
        place(self.residuals, k, found.residuals.len()).copy_from_slice(&found.residuals);
        Ok(())
    }
}

/// The k-th of equal pieces.
fn place(numbers: &mut [f64], k: usize, size: usize) -> &mut [f64] {
    &mut numbers[k * size..(k + 1) * size]
}

/// What a thread keeps from part to part.
#[derive(Default)]
pub(super) struct Workspace {
    /// Of the run of this number.
    plan: Option<(usize, Option<Plan>)>,
    space: Vec<f64>,
}

/// How the problems of a run are solved side by side.
struct Plan {
    shape: Shape,
    /// Rows that each pair holds out.
    held: Sets<'static>,
    /// Rows that each pair validates, one after another.
    validated: Vec<usize>,
    /// Where among those that the pair holds out.
    places: Vec<usize>,
    /// Where each pair ends in these.
    ends: Vec<usize>,
    /// Rows that the largest pair holds out.
    most: usize,
}

impl Plan {
    /// None if the problems are better solved alone.
    fn new(run: &Run<'_>) -> Option<Self> {
        let shape = run.shape();
        let many = run.scheme.held.mean() * run.scheme.validated.len() as f64 > MOST_HELD;
        if run.count == 1 || shape.rows < shape.columns || shape.vectors() > MOST_VECTORS || many {
            return None;
        }
        let (mut held, mut validated, mut places, mut ends) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut members, mut most) = (Vec::new(), 0);
        for pair in 0..run.scheme.validated.len() {
            run.scheme.held.members(pair, &mut members);
            let rows: Vec<usize> = members.iter().flat_map(|&datum| run.data.get(datum)).copied().collect();
            for row in run.scheme.validated.get(pair).iter().flat_map(|&datum| run.data.get(datum)) {
                validated.push(*row);
                places.push(rows.iter().position(|held| held == row)?);
            }
            ends.push(places.len());
            most = most.max(rows.len());
            held.push(rows);
        }
        let plan = Self { shape, held: held.into_iter().collect(), validated, places, ends, most };
        (shape.rows >= shape.columns + most && plan.vectors() <= MOST_VECTORS).then_some(plan)
    }

    /// Of the rows of a pair, and where its predictions are.
    fn pair(&self, k: usize) -> (Pair<'_>, std::ops::Range<usize>) {
        let validated = k.checked_sub(1).map_or(0, |before| self.ends[before])..self.ends[k];
        let pair = Pair {
            held: self.held.get(k),
            validated: &self.validated[validated.clone()],
            places: &self.places[validated.clone()],
        };
        (pair, validated.start * self.shape.responses..validated.end * self.shape.responses)
    }

    /// Vectors of the fits, of the systems, of the predictions, and the three of a [`Summary`].
    fn sizes(&self) -> [usize; 4] {
        let Shape { columns, responses, .. } = self.shape;
        let systems = pairs::vectors(self.most, columns, responses);
        [self.shape.vectors(), systems, self.validated.len() * responses, 3]
    }

    fn vectors(&self) -> usize {
        self.sizes().into_iter().sum()
    }

    /// Fits and cross-validates the problems that are loaded.
    #[inline(always)]
    fn solve<S: Simd>(&self, simd: S, problems: &[Problem<'_>], space: &mut [S::f64s]) {
        let [fits, systems, predictions, _] = self.sizes();
        let (fits, space) = space.split_at_mut(fits);
        let (systems, space) = space.split_at_mut(systems);
        let (predictions, summary) = space.split_at_mut(predictions);
        let (fits, mut far) = Fits::new(simd, self.shape, problems, fits);
        let mut system = System::new(self.most, self.shape.columns, systems);
        for k in 0..self.held.len() {
            let (pair, place) = self.pair(k);
            let of_use = system.predict(simd, &fits, pair, &mut predictions[place]);
            far = simd.and_m64s(far, of_use);
        }
        let [zero, one] = [0.0, 1.0].map(|x| simd.splat_f64s(x));
        summary[0] = simd.select_f64s(far, one, zero);
        summary[1] = dot(simd, predictions, predictions);
        summary[2] = dot(simd, fits.residuals, fits.residuals);
    }
}

/// Solves the problems of a part in the lanes of vectors; those that are left are returned.
struct SideBySide<'a, 'b> {
    part: &'a mut Part<'b>,
    plan: &'a Plan,
    space: &'a mut Vec<f64>,
}

impl WithSimd for SideBySide<'_, '_> {
    type Output = Vec<usize>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<usize> {
        let Self { part, plan, space } = self;
        let (width, needed) = (S::F64_LANES, plan.vectors() * S::F64_LANES);
        // Vectors that start at a cache line are loaded in one go.
        space.resize(space.len().max(needed + LINE), 0.0);
        let start = space.as_ptr().align_offset(LINE * size_of::<f64>()).min(LINE);
        let space = &mut space[start..start + needed];
        let mut left = Vec::new();
        for first in (0..part.scores.len()).step_by(width) {
            let lanes = first..part.scores.len().min(first + width);
            let problems: Vec<_> = lanes.clone().map(|k| part.run.1.problem(part.first + k)).collect();
            plan.shape.load(&problems, width, space);
            plan.solve(simd, &problems, S::as_mut_simd_f64s(space).0);
            for k in lanes {
                if !part.unpack(plan, k, space, (width, k - first)) {
                    left.push(k);
                }
            }
        }
        left
    }
}

/// Numbers of a cache line.
const LINE: usize = 8;

impl Part<'_> {
    /// Takes what was found for a problem out of its lane, unless it is of no use.
    #[inline(always)]
    fn unpack(&mut self, plan: &Plan, k: usize, space: &[f64], (width, lane): (usize, usize)) -> bool {
        let [fits, systems, predictions, _] = plan.sizes();
        let Shape { rows, columns, responses } = plan.shape;
        let of = |first: usize, count: usize| {
            space[first * width..(first + count) * width].iter().skip(lane).step_by(width)
        };
        let mut summary = of(fits + systems + predictions, 3).copied();
        let [of_use, squares, residual_squares] = std::array::from_fn(|_| summary.next().unwrap_or(0.0));
        if of_use == 0.0 {
            return false;
        }
        let run = self.run.1;
        let roots = run.problem(self.first + k).root_weights;
        let weight = |data: &mut dyn ExactSizeIterator<Item = usize>| match roots {
            None => data.len() as f64,
            Some(roots) => data.map(|datum| roots[run.data.get(datum)[0]].powi(2)).sum(),
        };
        self.scores[k] = (squares / weight(&mut run.scheme.validated.items.iter().copied())).sqrt();
        self.fit_rms[k] = (residual_squares / weight(&mut (0..run.data.len()))).sqrt();
        self.ranks[k] = columns;
        let solution = place(self.coefficients, k, columns * responses);
        solution
            .iter_mut()
            .zip(of(rows * (columns + responses), columns * responses))
            .for_each(|(x, y)| *x = *y);
        let residuals = place(self.residuals, k, predictions);
        residuals.iter_mut().zip(of(fits + systems, predictions)).for_each(|(x, y)| *x = *y);
        if let Some(roots) = roots {
            for (residual, row) in residuals.chunks_exact_mut(responses).zip(&plan.validated) {
                residual.iter_mut().for_each(|e| *e /= roots[*row]);
            }
        }
        true
    }
}
