//! Control points spread evenly over a region: Lloyd's algorithm, and where it starts.

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::near::neighbours::unit_scale;
use crate::pool::Pool;

/// Samples that share a list of the centres that may be nearest to them: few, so that the list is short, but
/// several groups, so that making it costs less than using it.
const BLOCK_SAMPLES: usize = 64;

/// Samples compared with a centre at once: two of the widest vector registers.
const LANES: usize = 16;

/// Distances a task should be worth: waking a thread costs about as much as a tenth of these.
const TASK: usize = 200_000;

/// How far centres may move before the lists are made anew, as a fraction of a block's diagonal: long lists
/// or many of them.
const SLACK: f64 = 0.1;

/// What the rounding of a distance stays below; coordinates are about one at most.
const ROUNDING: f64 = 1e-12;

/// Centres moved, from `start`, until each is the mean of the samples that are nearer to it than to any
/// other.
///
/// `samples` and `start` hold x and y in turn; so does the result. A sample at the same distance from several
/// centres belongs to the first of them. A centre without samples moves to the sample farthest from its own
/// centre. Stops after `max_steps`, or when no centre has moved by more than `tolerance`; without samples,
/// nothing moves. Fails if a length is odd or, naming the first of them, if some values are not finite.
///
/// ```
/// use mexpress::{place::lloyd::lloyd, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let region = [0.0, 0.0, 1.0, 0.0, 8.0, 0.0, 9.0, 0.0];
/// let centres = lloyd(&region, &[0.0, 0.0, 1.0, 0.0], 100, 0.0, &Pool::new(1, &flag))?;
/// assert_eq!(centres, [0.5, 0.0, 8.5, 0.0]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn lloyd(
    samples: &[f64],
    start: &[f64],
    max_steps: usize,
    tolerance: f64,
    pool: &Pool,
) -> Result<Vec<f64>, Error> {
    for values in [samples, start] {
        if values.len() % 2 == 1 {
            return Err(Error::Length { expected: values.len() - 1, given: values.len() });
        }
    }
    let scale = unit_scale(samples.iter().chain(start).copied())?;
    if samples.is_empty() || start.is_empty() {
        return Ok(start.to_vec());
    }
    let scaled = |values: &[f64]| values.chunks_exact(2).map(|v| [v[0] * scale, v[1] * scale]).collect();
    let mut cells = Cells::new(scaled(samples), scaled(start), BLOCK_SAMPLES);
    for _ in 0..max_steps {
        if cells.step(pool)? <= tolerance * scale {
            break;
        }
    }
    Ok(cells.centres.into_iter().flatten().map(|value| value / scale).collect())
}

/// Samples drawn for a start: the first evenly, each other with a probability that grows with its squared distance to
/// those already drawn.
///
/// `samples` holds x and y in turn; each of `draws`, from 0 to below 1, makes one of the indices returned. Without
/// samples there are none; a sample is drawn twice only if no other is elsewhere. Fails as [`lloyd`] does.
///
/// ```
/// use mexpress::{place::lloyd::spread, pool::Pool};
/// let flag = std::sync::atomic::AtomicBool::new(false);
/// let places = [0.0, 0.0, 1.0, 0.0, 9.0, 0.0];
/// assert_eq!(spread(&places, &[0.1, 0.2, 0.9], &Pool::new(1, &flag))?, [0, 2, 1]);
/// # Ok::<(), mexpress::error::Error>(())
/// ```
pub fn spread(samples: &[f64], draws: &[f64], pool: &Pool) -> Result<Vec<usize>, Error> {
    if samples.len() % 2 == 1 {
        return Err(Error::Length { expected: samples.len() - 1, given: samples.len() });
    }
    let scale = unit_scale(samples.iter().copied())?;
    if samples.is_empty() {
        return Ok(Vec::new());
    }
    let coordinate = |axis: usize| samples.iter().skip(axis).step_by(2).map(|value| value * scale).collect();
    let (x, y): (Vec<f64>, Vec<f64>) = (coordinate(0), coordinate(1));
    let mut weights = vec![1.0; x.len()];
    let arch = Arch::new();
    let mut drawn = Vec::with_capacity(draws.len());
    for &draw in draws {
        pool.proceed()?;
        let i = pick(&weights, draw);
        if drawn.is_empty() {
            weights.fill(f64::INFINITY);
        }
        arch.dispatch(Approach { x: &x, y: &y, place: [x[i], y[i]], weights: &mut weights });
        drawn.push(i);
    }
    Ok(drawn)
}

/// The first item at which the running sum of the weights exceeds a fraction of their total.
fn pick(weights: &[f64], fraction: f64) -> usize {
    // Sums of blocks, so that the sum does not run over all of them.
    let sums: Vec<f64> = weights.chunks(BLOCK_SAMPLES).map(|part| part.iter().sum()).collect();
    let mut left = fraction * sums.iter().sum::<f64>();
    for (part, sum) in sums.iter().enumerate() {
        if *sum <= left {
            left -= sum;
            continue;
        }
        for (i, weight) in weights.iter().enumerate().skip(part * BLOCK_SAMPLES).take(BLOCK_SAMPLES) {
            if *weight > left {
                return i;
            }
            left -= weight;
        }
    }
    // Rounding has run past the end.
    weights.iter().rposition(|&weight| weight > 0.0).unwrap_or(0)
}

/// Lowers each weight to the squared distance from a place.
struct Approach<'a> {
    x: &'a [f64],
    y: &'a [f64],
    place: Point,
    weights: &'a mut [f64],
}

impl WithSimd for Approach<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for ((x, y), weight) in self.x.iter().zip(self.y).zip(self.weights) {
            *weight = weight.min(between([*x, *y], self.place));
        }
    }
}

type Point = [f64; 2];

/// The centres, and the samples in compact blocks.
///
/// A centre nearest to a sample of a block is not farther from the block than any centre is from the block's
/// farthest corner. Few centres are that near, so each block has a list of them, which stays good until a
/// centre has moved by more than `slack` if it is long enough by twice that.
struct Cells {
    blocks: Vec<Block>,
    centres: Vec<Point>,
    /// Whether the last step moved the centre.
    moved: Vec<bool>,
    slack: f64,
    /// An upper bound on how far any centre has moved since the lists were made.
    drift: f64,
}

impl Cells {
    fn new(samples: Vec<Point>, centres: Vec<Point>, block: usize) -> Self {
        let mut order: Vec<usize> = (0..samples.len()).collect();
        let mut blocks = Vec::new();
        split(&samples, &mut order, block, &mut blocks);
        let diagonals: f64 = blocks.iter().map(|b| between(b.low, b.high).sqrt()).sum();
        let slack = SLACK * diagonals / blocks.len() as f64;
        Self { moved: vec![true; centres.len()], drift: f64::INFINITY, blocks, centres, slack }
    }

    /// Assigns and moves once; the largest move.
    fn step(&mut self, pool: &Pool) -> Result<f64, Error> {
        self.assign(pool)?;
        let mut totals = vec![[0.0; 3]; self.centres.len()];
        for block in &self.blocks {
            for (&c, sum) in block.near.iter().zip(&block.sums) {
                totals[c] = std::array::from_fn(|k| totals[c][k] + sum[k]);
            }
        }
        let is_empty = |c: &usize| totals[*c][2] == 0.0;
        let empty: Vec<usize> = (0..totals.len()).filter(is_empty).collect();
        let mut next: Vec<Point> = totals.iter().map(|t| [t[0] / t[2], t[1] / t[2]]).collect();
        let mut far = farthest(&self.blocks, empty.len()).into_iter();
        for c in empty {
            next[c] = far.next().unwrap_or(self.centres[c]);
        }
        let pairs = self.centres.iter().zip(&next);
        let largest = pairs.clone().map(|(a, b)| between(*a, *b)).fold(0.0, f64::max).sqrt();
        self.moved = pairs.map(|(a, b)| a != b).collect();
        self.drift += largest;
        self.centres = next;
        Ok(largest)
    }

    /// Each sample's nearest centre, and what every centre gets from every block.
    fn assign(&mut self, pool: &Pool) -> Result<(), Error> {
        let anew = self.drift > self.slack;
        if anew {
            self.drift = 0.0;
        }
        let listed =
            self.blocks.iter().map(|b| b.items.len() * b.near.len()).sum::<usize>() / self.blocks.len();
        let blocks_a_task = TASK.div_ceil(listed.max(self.centres.len()));
        let (centres, moved, slack) = (&self.centres, &self.moved, self.slack);
        let workspace = || (Arch::new(), Vec::new());
        pool.run(self.blocks.chunks_mut(blocks_a_task), workspace, |(arch, near), task: &mut [Block]| {
            for block in task {
                if anew {
                    arch.dispatch(List { block, centres, slack });
                }
                if anew || block.near.iter().any(|&c| moved[c]) {
                    near.clear();
                    near.extend(block.near.iter().map(|&c| centres[c]));
                    arch.dispatch(Assign { groups: &mut block.groups, near });
                    block.sum();
                }
            }
        })
    }
}

/// Blocks of at most so many of the samples, all but the last of them full, each as compact as halving the longer side
/// makes it.
fn split(samples: &[Point], order: &mut [usize], most: usize, blocks: &mut Vec<Block>) {
    if order.len() <= most {
        // In the order of the indices, so that rounding does not depend on how they were halved.
        order.sort_unstable();
        blocks.push(Block::new(samples, order));
        return;
    }
    let (low, high) = bounds(samples, order);
    let axis = usize::from(high[1] - low[1] > high[0] - low[0]);
    let half = (order.len().div_ceil(most) / 2) * most;
    order
        .select_nth_unstable_by(half, |&a, &b| samples[a][axis].total_cmp(&samples[b][axis]).then(a.cmp(&b)));
    let (first, second) = order.split_at_mut(half);
    split(samples, first, most, blocks);
    split(samples, second, most, blocks);
}

fn bounds(samples: &[Point], items: &[usize]) -> (Point, Point) {
    let start = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    items.iter().fold(start, |(low, high), &i| {
        let sample = samples[i];
        (std::array::from_fn(|k| low[k].min(sample[k])), std::array::from_fn(|k| high[k].max(sample[k])))
    })
}

/// The squared distance of two points.
fn between(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

/// The samples that are farthest from their centres, the farthest first.
fn farthest(blocks: &[Block], count: usize) -> Vec<Point> {
    if count == 0 {
        return Vec::new();
    }
    let mut all: Vec<(f64, usize, Point)> = blocks.iter().flat_map(Block::spread).collect();
    all.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    all.into_iter().take(count).map(|(_, _, sample)| sample).collect()
}

/// Some of the samples, near each other, in groups of `LANES`; the last group may be filled up with zeros.
struct Block {
    /// Which samples they are.
    items: Vec<usize>,
    groups: Vec<Group>,
    low: Point,
    high: Point,
    /// The centres that may be nearest to one of the samples, in increasing order.
    near: Vec<usize>,
    /// Sum of x, sum of y, number of the samples that are nearest to each of these.
    sums: Vec<[f64; 3]>,
}

struct Group {
    x: [f64; LANES],
    y: [f64; LANES],
    /// Squared distance from the nearest centre.
    distance: [f64; LANES],
    /// Its place in the block's list; as wide as a distance, so that both are selected by the same mask.
    nearest: [u64; LANES],
}

impl Block {
    fn new(samples: &[Point], items: &[usize]) -> Self {
        let group = |part: &[usize]| {
            let coordinate = |lane: usize, axis: usize| part.get(lane).map_or(0.0, |&i| samples[i][axis]);
            let x = std::array::from_fn(|lane| coordinate(lane, 0));
            let y = std::array::from_fn(|lane| coordinate(lane, 1));
            Group { x, y, distance: [0.0; LANES], nearest: [0; LANES] }
        };
        let groups = items.chunks(LANES).map(group).collect();
        let (low, high) = bounds(samples, items);
        Self { items: items.to_vec(), groups, low, high, near: Vec::new(), sums: Vec::new() }
    }

    /// Sums the samples of each centre of the list.
    fn sum(&mut self) {
        self.sums.clear();
        self.sums.resize(self.near.len(), [0.0; 3]);
        let lanes = self.groups.iter().flat_map(|g| g.x.iter().zip(&g.y).zip(&g.nearest));
        for ((x, y), &centre) in lanes.take(self.items.len()) {
            let sum = &mut self.sums[centre as usize];
            *sum = [sum[0] + x, sum[1] + y, sum[2] + 1.0];
        }
    }

    fn spread(&self) -> impl Iterator<Item = (f64, usize, Point)> {
        let lanes = self.groups.iter().flat_map(|g| (0..LANES).map(|i| (g.distance[i], [g.x[i], g.y[i]])));
        lanes.zip(&self.items).map(|((distance, sample), &item)| (distance, item, sample))
    }
}

/// Lists the centres that may be nearest to one of a block's samples while none moves by more than `slack`.
struct List<'a> {
    block: &'a mut Block,
    centres: &'a [Point],
    slack: f64,
}

impl WithSimd for List<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { block: Block { low, high, near, .. }, centres, slack } = self;
        let inner = |c: Point| std::array::from_fn(|k| c[k].max(low[k]).min(high[k]));
        let outer =
            |c: Point| std::array::from_fn(|k| if c[k] - low[k] > high[k] - c[k] { low[k] } else { high[k] });
        let mut least = [f64::INFINITY; LANES];
        for part in centres.chunks(LANES) {
            for (least, &c) in least.iter_mut().zip(part) {
                *least = least.min(between(c, outer(c)));
            }
        }
        let least = least.into_iter().fold(f64::INFINITY, f64::min);
        let reach = (least.sqrt() + 2.0 * slack + ROUNDING).powi(2);
        near.clear();
        near.extend((0..centres.len()).filter(|&c| between(centres[c], inner(centres[c])) <= reach));
    }
}

/// Finds each sample's nearest centre among those of its block's list.
struct Assign<'a> {
    groups: &'a mut [Group],
    near: &'a [Point],
}

impl WithSimd for Assign<'_> {
    type Output = ();

    /// Plain loops: the compiler makes vector instructions of them, and lanes make no difference to the result.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for group in self.groups {
            let (mut distance, mut nearest) = ([f64::INFINITY; LANES], [0; LANES]);
            for (c, &[x, y]) in self.near.iter().enumerate() {
                for lane in 0..LANES {
                    let (dx, dy) = (group.x[lane] - x, group.y[lane] - y);
                    let square = dx * dx + dy * dy;
                    let nearer = square < distance[lane];
                    distance[lane] = if nearer { square } else { distance[lane] };
                    nearest[lane] = if nearer { c as u64 } else { nearest[lane] };
                }
            }
            (group.distance, group.nearest) = (distance, nearest);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use proptest::prelude::*;

    use super::*;

    fn run(samples: &[f64], start: &[f64], steps: usize, threads: usize) -> Vec<f64> {
        let flag = AtomicBool::new(false);
        lloyd(samples, start, steps, 0.0, &Pool::new(threads, &flag)).unwrap()
    }

    fn squares<'a>(sample: &'a [f64], centres: &'a [f64]) -> impl Iterator<Item = f64> + 'a {
        centres.chunks(2).map(|c| (sample[0] - c[0]).powi(2) + (sample[1] - c[1]).powi(2))
    }

    fn energy(samples: &[f64], centres: &[f64]) -> f64 {
        samples.chunks(2).map(|s| squares(s, centres).fold(f64::INFINITY, f64::min)).sum()
    }

    /// One step by the definition.
    fn oracle(samples: &[f64], centres: &[f64]) -> Vec<f64> {
        let nearest = |s: &[f64]| {
            let all: Vec<f64> = squares(s, centres).collect();
            (0..all.len()).fold(0, |best, c| if all[c] < all[best] { c } else { best })
        };
        let owner: Vec<usize> = samples.chunks(2).map(nearest).collect();
        let apart = |s: usize| squares(&samples[2 * s..], centres).nth(owner[s]).unwrap();
        let mut far: Vec<usize> = (0..owner.len()).collect();
        far.sort_by(|&a, &b| apart(b).total_cmp(&apart(a)).then(a.cmp(&b)));
        let mut far = far.into_iter();
        let mut moved = centres.to_vec();
        for c in 0..centres.len() / 2 {
            let own: Vec<usize> = (0..owner.len()).filter(|&s| owner[s] == c).collect();
            for axis in 0..2 {
                let sum: f64 = own.iter().map(|&s| samples[2 * s + axis]).sum();
                moved[2 * c + axis] =
                    if own.is_empty() { centres[2 * c + axis] } else { sum / own.len() as f64 };
            }
            if own.is_empty()
                && let Some(s) = far.next()
            {
                moved[2 * c..2 * c + 2].copy_from_slice(&samples[2 * s..2 * s + 2]);
            }
        }
        moved
    }

    /// Pairs of coordinates, random or on a coarse grid, where ties and empty centres abound.
    fn clouds(most: usize) -> impl Strategy<Value = Vec<f64>> {
        (1..most, prop_oneof![Just(2), Just(8), Just(1_i64 << 40)]).prop_flat_map(|(n, cells)| {
            prop::collection::vec((-cells..cells).prop_map(|c| c as f64 * 0.25), 2 * n)
        })
    }

    proptest! {
        #[test]
        fn a_step_is_what_the_definition_says(samples in clouds(60), start in clouds(12)) {
            let (found, expected) = (run(&samples, &start, 1, 1), oracle(&samples, &start));
            let size = samples.iter().chain(&start).fold(0.0_f64, |m, v| m.max(v.abs()));
            for (a, b) in found.iter().zip(&expected) {
                prop_assert!((a - b).abs() <= 1e-13 * size, "{found:?} {expected:?}");
            }
        }

        #[test]
        fn lists_of_near_centres_leave_none_out(
            samples in clouds(150), start in clouds(30), most in 1..40_usize, threads in 1..3_usize
        ) {
            let flag = AtomicBool::new(false);
            let scale = unit_scale(samples.iter().chain(&start).copied()).unwrap();
            let points = |v: &[f64]| v.chunks(2).map(|p| [p[0] * scale, p[1] * scale]).collect::<Vec<Point>>();
            let flat = |v: &[Point]| v.iter().flatten().copied().collect::<Vec<f64>>();
            let scaled = flat(&points(&samples));
            let mut cells = Cells::new(points(&samples), points(&start), most);
            for _ in 0..12 {
                let expected = oracle(&scaled, &flat(&cells.centres));
                cells.step(&Pool::new(threads, &flag)).unwrap();
                for (a, b) in flat(&cells.centres).iter().zip(&expected) {
                    prop_assert!((a - b).abs() <= 1e-13, "{:?} {expected:?}", cells.centres);
                }
            }
        }

        #[test]
        fn a_draw_goes_by_the_squared_distance(
            samples in prop::collection::vec((-40..40).prop_map(f64::from), 2..400),
            draws in prop::collection::vec((0..64).prop_map(|d| f64::from(d) / 64.0), 0..8),
        ) {
            let samples = &samples[..samples.len() / 2 * 2];
            let mut weights = vec![1.0; samples.len() / 2];
            let mut expected: Vec<usize> = Vec::new();
            for draw in &draws {
                let wanted = draw * weights.iter().sum::<f64>();
                let mut running = 0.0;
                let passes = |weight: &f64| { running += weight; running > wanted };
                let drawn = weights.iter().position(passes).unwrap_or(0);
                expected.push(drawn);
                let centres: Vec<f64> = expected.iter().flat_map(|&i| samples[2 * i..2 * i + 2].to_vec()).collect();
                let nearest = |s: &[f64]| squares(s, &centres).fold(f64::INFINITY, f64::min);
                weights = samples.chunks(2).map(nearest).collect();
            }
            let flag = AtomicBool::new(false);
            prop_assert_eq!(spread(samples, &draws, &Pool::new(1, &flag)).unwrap(), expected);
        }

        #[test]
        fn energy_never_increases(samples in clouds(60), start in clouds(12)) {
            let energies: Vec<f64> =
                (0..8).map(|steps| energy(&samples, &run(&samples, &start, steps, 1))).collect();
            prop_assert!(energies.windows(2).all(|w| w[1] <= w[0] * (1.0 + 1e-12)), "{energies:?}");
        }
    }

    fn square(side: usize) -> Vec<f64> {
        let at = |i: usize| (i as f64 + 0.5) / side as f64;
        (0..side * side).flat_map(|i| [at(i % side), at(i / side)]).collect()
    }

    #[test]
    fn four_centres_share_a_square() {
        let start = [0.1, 0.2, 0.7, 0.1, 0.2, 0.8, 0.9, 0.7];
        let centres = run(&square(60), &start, 100, 1);
        let expected = [0.25, 0.25, 0.75, 0.25, 0.25, 0.75, 0.75, 0.75];
        assert!(centres.iter().zip(expected).all(|(c, e)| (c - e).abs() < 0.01), "{centres:?}");
    }

    #[test]
    fn threads_do_not_matter() {
        let (samples, start) = (square(130), &square(9)[..120]);
        let one = run(&samples, start, 10, 1);
        assert_eq!(one, run(&samples, start, 10, 2));
        assert_eq!(one, run(&samples, start, 10, 7));
    }

    #[test]
    fn centres_without_samples_find_some() {
        let samples = [0.0, 0.0, 1.0, 0.0, 5.0, 0.0];
        assert_eq!(run(&samples, &[0.0, 0.0, 9.0, 9.0, 9.0, 9.0], 1, 1), [2.0, 0.0, 5.0, 0.0, 1.0, 0.0]);
        let equal = run(&[1.0; 8], &[0.0, 0.0, 3.0, 3.0, 4.0, 4.0], 9, 1);
        assert_eq!(equal, [1.0; 6]);
        assert_eq!(run(&[2.0, 3.0], &[0.0, 0.0, 9.0, 9.0, 8.0, 8.0], 1, 1)[2..], [2.0, 3.0, 8.0, 8.0]);
    }

    #[test]
    fn draws_from_little_or_nothing() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        assert_eq!(spread(&[], &[0.5], &pool), Ok(vec![]));
        assert_eq!(spread(&[3.0; 4], &[0.9, 0.9], &pool), Ok(vec![1, 0]));
        // Rounding would draw the last sample again, where one is drawn already.
        assert_eq!(spread(&[0.1, 0.0, 0.2, 0.0, 0.3, 0.0], &[0.9, 1.0, 1.0], &pool), Ok(vec![2, 1, 0]));
        assert_eq!(spread(&[1.0], &[0.5], &pool), Err(Error::Length { expected: 0, given: 1 }));
        assert_eq!(spread(&[1.0, f64::INFINITY], &[0.5], &pool), Err(Error::NotFinite { index: 1 }));
        flag.store(true, std::sync::atomic::Ordering::Relaxed);
        assert_eq!(spread(&[1.0, 2.0], &[0.5], &pool), Err(Error::Interrupted));
    }

    #[test]
    fn nothing_to_do() {
        assert!(run(&[1.0, 2.0], &[], 5, 1).is_empty());
        assert_eq!(run(&[], &[1.0, 2.0], 5, 1), [1.0, 2.0]);
        assert_eq!(run(&[0.0; 2], &[1.0, 2.0], 0, 1), [1.0, 2.0]);
    }

    #[test]
    fn any_finite_magnitude_will_do() {
        for size in [1e300, 1e-300] {
            let samples = [0.0, 0.0, size, 0.0, 8.0 * size, 0.0];
            assert_eq!(run(&samples, &samples[2..], 50, 1), [size / 2.0, 0.0, 8.0 * size, 0.0]);
        }
    }

    #[test]
    fn a_wide_tolerance_stops_early_and_bad_values_are_named() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        let (samples, start) = (square(20), [0.0, 0.0, 0.1, 0.0]);
        assert_eq!(lloyd(&samples, &start, 50, 9.0, &pool).unwrap(), run(&samples, &start, 1, 1));
        assert_eq!(lloyd(&[1.0], &start, 1, 0.0, &pool), Err(Error::Length { expected: 0, given: 1 }));
        let undefined = lloyd(&[1.0, f64::NAN], &start, 1, 0.0, &pool);
        assert_eq!(undefined, Err(Error::NotFinite { index: 1 }));
        flag.store(true, std::sync::atomic::Ordering::Relaxed);
        assert_eq!(lloyd(&samples, &start, 1, 0.0, &Pool::new(1, &flag)), Err(Error::Interrupted));
    }
}
