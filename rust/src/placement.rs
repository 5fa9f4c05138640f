//! Lloyd's algorithm: control points spread evenly over a region.

use crate::error::Error;
use crate::neighbours::unit_scale;
use crate::pool::Pool;

/// Samples whose sums are taken together: fixed, so that the order of additions is.
const BLOCK: usize = 1024;

/// Samples compared with a centre at once: two of the widest vector registers.
const LANES: usize = 16;

/// Distances a task should be worth: waking a thread costs about as much as a tenth of these.
const TASK: usize = 200_000;

/// Centres moved, from `start`, until each is the mean of the samples that are nearer to it than to any
/// other.
///
/// `samples` and `start` hold x and y in turn; so does the result. A sample at the same distance from several
/// centres belongs to the first of them. A centre without samples moves to the sample farthest from its own
/// centre. Stops after `max_steps`, or when no centre has moved by more than `tolerance`; without samples,
/// nothing moves. Fails if a length is odd or, naming the first of them, if some values are not finite.
///
/// ```
/// use mexpress::{placement::lloyd, pool::Pool};
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
    let mut blocks: Vec<Block> = samples.chunks(2 * BLOCK).map(|part| Block::new(part, scale)).collect();
    let mut centres: Vec<[f64; 2]> = start.chunks_exact(2).map(|c| [c[0] * scale, c[1] * scale]).collect();
    if samples.is_empty() || start.is_empty() {
        return Ok(start.to_vec());
    }
    for _ in 0..max_steps {
        let moved = step(&mut blocks, &mut centres, pool)?;
        if moved <= (tolerance * scale).powi(2) {
            break;
        }
    }
    Ok(centres.into_iter().flatten().map(|value| value / scale).collect())
}

/// Assigns and moves once; the largest squared move.
fn step(blocks: &mut [Block], centres: &mut [[f64; 2]], pool: &Pool) -> Result<f64, Error> {
    let blocks_a_task = TASK.div_ceil(BLOCK * centres.len());
    let fixed = &*centres;
    pool.run(blocks.chunks_mut(blocks_a_task), pulp::Arch::new, |arch, task: &mut [Block]| {
        for block in task {
            arch.dispatch(|| block.assign(fixed));
            block.sum(fixed.len());
        }
    })?;
    let mut moved = 0.0_f64;
    let mut empty = Vec::new();
    for (c, centre) in centres.iter_mut().enumerate() {
        let total =
            blocks.iter().fold([0.0; 3], |t, b| std::array::from_fn(|axis| t[axis] + b.sums[c][axis]));
        if total[2] > 0.0 {
            moved = moved.max(put(centre, [total[0] / total[2], total[1] / total[2]]));
        } else {
            empty.push(c);
        }
    }
    for (c, sample) in empty.iter().zip(farthest(blocks, empty.len())) {
        moved = moved.max(put(&mut centres[*c], sample));
    }
    Ok(moved)
}

/// Moves a centre; the square of how far.
fn put(centre: &mut [f64; 2], to: [f64; 2]) -> f64 {
    let [x, y] = std::mem::replace(centre, to);
    (to[0] - x).powi(2) + (to[1] - y).powi(2)
}

/// The samples that are farthest from their centres, the farthest first.
fn farthest(blocks: &[Block], count: usize) -> Vec<[f64; 2]> {
    if count == 0 {
        return Vec::new();
    }
    let mut all: Vec<(f64, [f64; 2])> = blocks.iter().flat_map(Block::spread).collect();
    // Stable: of samples at the same distance the first comes first.
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.into_iter().take(count).map(|(_, sample)| sample).collect()
}

/// Some of the samples, in groups of `LANES`; the last group may be filled up with zeros.
struct Block {
    count: usize,
    groups: Vec<Group>,
    /// Sum of x, sum of y, number of the samples of each centre.
    sums: Vec<[f64; 3]>,
}

struct Group {
    x: [f64; LANES],
    y: [f64; LANES],
    /// Squared distance from the nearest centre.
    distance: [f64; LANES],
    /// Which centre that is; as wide as a distance, so that both are selected by the same mask.
    nearest: [u64; LANES],
}

impl Block {
    fn new(samples: &[f64], scale: f64) -> Self {
        let group = |part: &[f64]| {
            let coordinate = |at| part.get(at).map_or(0.0, |value| value * scale);
            let x = std::array::from_fn(|lane| coordinate(2 * lane));
            let y = std::array::from_fn(|lane| coordinate(2 * lane + 1));
            Group { x, y, distance: [0.0; LANES], nearest: [0; LANES] }
        };
        let groups = samples.chunks(2 * LANES).map(group).collect();
        Self { count: samples.len() / 2, groups, sums: Vec::new() }
    }

    #[inline(always)]
    fn assign(&mut self, centres: &[[f64; 2]]) {
        for group in &mut self.groups {
            group.assign(centres);
        }
    }

    fn sum(&mut self, centres: usize) {
        self.sums.clear();
        self.sums.resize(centres, [0.0; 3]);
        let lanes = self.groups.iter().flat_map(|g| g.x.iter().zip(&g.y).zip(&g.nearest));
        for ((x, y), &centre) in lanes.take(self.count) {
            let sum = &mut self.sums[centre as usize];
            *sum = [sum[0] + x, sum[1] + y, sum[2] + 1.0];
        }
    }

    fn spread(&self) -> impl Iterator<Item = (f64, [f64; 2])> {
        let lanes = self.groups.iter().flat_map(|g| (0..LANES).map(|i| (g.distance[i], [g.x[i], g.y[i]])));
        lanes.take(self.count)
    }
}

impl Group {
    /// Inlined, so that it is compiled for the vector registers of whoever calls.
    #[inline(always)]
    fn assign(&mut self, centres: &[[f64; 2]]) {
        let (mut distance, mut nearest) = ([f64::INFINITY; LANES], [0; LANES]);
        for (c, &[x, y]) in centres.iter().enumerate() {
            for lane in 0..LANES {
                let (dx, dy) = (self.x[lane] - x, self.y[lane] - y);
                let square = dx * dx + dy * dy;
                let nearer = square < distance[lane];
                distance[lane] = if nearer { square } else { distance[lane] };
                nearest[lane] = if nearer { c as u64 } else { nearest[lane] };
            }
        }
        self.distance = distance;
        self.nearest = nearest;
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
