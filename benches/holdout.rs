//! Times the core: one factorisation, and pairs by each of the ways that a pair can be solved.

use std::hint::black_box;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use mexpress::fit::factor::{Factor, Problem};
use mexpress::holdout::scheme::{Held, Scheme};
use mexpress::pool::Pool;
use mexpress::sets::Sets;

static NEVER: AtomicBool = AtomicBool::new(false);

/// Pseudo-random numbers in -1..1.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

fn problem<'a>(design: &'a [f64], responses: &'a [f64]) -> Problem<'a> {
    let (rows, columns) = (responses.len(), design.len() / responses.len());
    Problem { design, responses, root_weights: None, penalty: &[], rows, columns }
}

fn fit(problem: &Problem<'_>, threads: usize) -> Factor {
    Factor::new(problem, &Pool::new(threads, &NEVER)).unwrap()
}

/// Each datum with those that follow it, around the end.
fn windows(n: usize, size: usize) -> Sets<'static> {
    let window = |i| {
        let mut set: Vec<usize> = (0..size).map(|k| (i + k) % n).collect();
        set.sort_unstable();
        set
    };
    (0..n).map(window).collect()
}

fn singles(n: usize) -> Sets<'static> {
    (0..n).map(|i| vec![i]).collect()
}

fn factor(c: &mut Criterion) {
    let mut group = c.benchmark_group("factor");
    for (rows, columns) in [(200, 20), (2_000, 60), (100_000, 40)] {
        let (design, responses) = (noise(rows * columns, 1), noise(rows, 2));
        let problem = problem(&design, &responses);
        group.throughput(Throughput::Elements((2 * rows * columns * columns) as u64));
        for threads in [1, 2] {
            let name = format!("{rows}x{columns}");
            group.bench_function(BenchmarkId::new(name, threads), |bencher| {
                bencher.iter(|| fit(black_box(&problem), threads));
            });
        }
    }
    group.finish();
}

/// Every datum validated, with `held` data left out: the number of rows decides how a pair is solved.
fn pairs(c: &mut Criterion) {
    let mut group = c.benchmark_group("pairs");
    let ways = [
        ("unrolled 1", 4_000, 60, 1),
        ("unrolled 2", 4_000, 60, 2),
        ("unrolled 3", 4_000, 60, 3),
        ("dual 4", 4_000, 60, 4),
        ("dual 20", 4_000, 60, 20),
        ("dual 60 of 150", 4_000, 150, 60),
        ("hat 20", 1_000, 60, 20),
        ("hat 40", 1_000, 60, 40),
        ("primal 101", 2_000, 60, 101),
        ("primal 400 of 20", 2_000, 20, 400),
        ("primal 400 of 200", 2_000, 200, 400),
    ];
    for (name, n, columns, held) in ways {
        let (design, responses) = (noise(n * columns, 1), noise(n, 2));
        let problem = problem(&design, &responses);
        let factor = fit(&problem, 1);
        let (held, validated, rows) = (windows(n, held), singles(n), singles(n));
        let order: Vec<usize> = (0..n).collect();
        let scheme = Scheme { held: Held::Sets(&held), validated: &validated, order: Some(&order) };
        group.throughput(Throughput::Elements(n as u64));
        for threads in [1, 2] {
            group.bench_function(BenchmarkId::new(name, threads), |bencher| {
                let pool = Pool::new(threads, &NEVER);
                bencher.iter(|| factor.predict(&problem, black_box(&[scheme]), &rows, &pool).unwrap());
            });
        }
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1));
    targets = factor, pairs
}
criterion_main!(benches);
