//! Threads: independent tasks, one workspace a thread, cancellable, safe after `fork`.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::Error;

/// Who does the work, and the flag that calls it off.
///
/// Tasks must write to disjoint places and may not depend on each other, so that results are the same bit
/// for bit for any number of threads.
#[derive(Clone, Copy)]
pub struct Pool<'a> {
    threads: usize,
    cancel: &'a AtomicBool,
}

impl<'a> Pool<'a> {
    /// At most `threads` threads; setting `cancel` ends the work after the tasks under way.
    pub fn new(threads: usize, cancel: &'a AtomicBool) -> Self {
        Self { threads: threads.max(1), cancel }
    }

    /// This thread alone, called off alike.
    pub fn alone(&self) -> Self {
        Self { threads: 1, ..*self }
    }

    /// How many threads there are at most.
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// Does every task, in any order, each thread with a workspace of its own.
    pub fn run<T: Send, W>(
        &self,
        tasks: impl ExactSizeIterator<Item = T> + Send,
        workspace: impl Fn() -> W + Sync,
        work: impl Fn(&mut W, T) + Sync,
    ) -> Result<(), Error> {
        let threads = self.threads.min(tasks.len());
        let queue = Mutex::new(tasks);
        let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
        let worker = || {
            let mut scratch = workspace();
            while !self.cancelled() {
                match next() {
                    Some(task) => work(&mut scratch, task),
                    None => break,
                }
            }
        };
        // A pool for each number that is asked for, not for each number of tasks: pools stay.
        match if threads > 1 { threads_of_this_process(self.threads - 1) } else { None } {
            // This thread works, too: it need not wait until the others are awake.
            Some(pool) => pool.in_place_scope(|scope| {
                (1..threads).for_each(|_| scope.spawn(|_| worker()));
                worker();
            }),
            None if threads > 0 => worker(),
            None => {}
        }
        self.proceed()
    }

    /// Does what cannot be interrupted on a thread of its own, which is left behind once the work is called off.
    pub fn aside<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, Error> {
        let (send, receive) = channel();
        std::thread::spawn(move || drop(send.send(work())));
        loop {
            match receive.recv_timeout(Duration::from_millis(20)) {
                Ok(result) => return Ok(result),
                Err(RecvTimeoutError::Timeout) => self.proceed()?,
                // It panicked; there is no result, and there never will be.
                Err(RecvTimeoutError::Disconnected) => return Err(Error::Interrupted),
            }
        }
    }

    /// An error once the work has been called off; long tasks ask now and then.
    pub fn proceed(&self) -> Result<(), Error> {
        if self.cancelled() { Err(Error::Interrupted) } else { Ok(()) }
    }

    fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }
}

/// The first numbers of a slice, for one task; the slice keeps the others.
pub(crate) fn take<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, others) = std::mem::take(rest).split_at_mut(count);
    *rest = others;
    first
}

/// Thread pools by process and size.
type Pools = HashMap<(u32, usize), Option<Arc<ThreadPool>>>;

/// A forked child inherits this map but not the threads behind it, hence the process id in the key. Its
/// parent's pools are kept, not dropped: dropping one would wait for threads that do not exist. None if the
/// operating system refuses threads.
fn threads_of_this_process(threads: usize) -> Option<Arc<ThreadPool>> {
    static POOLS: Mutex<Option<Pools>> = Mutex::new(None);
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    let pools = pools.get_or_insert_default();
    let slot = pools.entry((std::process::id(), threads)).or_default();
    if slot.is_none() {
        let builder = ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("mexpress-{i}"));
        *slot = builder.build().ok().map(Arc::new);
    }
    slot.clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_task_is_done_once() {
        let flag = AtomicBool::new(false);
        for threads in [1, 2, 5] {
            let mut done = vec![0; 100];
            Pool::new(threads, &flag).run(done.iter_mut(), || (), |(), d| *d += 1).unwrap();
            assert_eq!(done, vec![1; 100]);
        }
    }

    #[test]
    fn tasks_take_their_places_one_after_another() {
        let mut places = [1, 2, 3, 4];
        let mut rest = &mut places[..];
        assert_eq!(take(&mut rest, 1), [1]);
        assert_eq!(take(&mut rest, 2), [2, 3]);
        assert_eq!(rest, [4]);
    }

    #[test]
    fn a_set_flag_stops_the_work() {
        let flag = AtomicBool::new(false);
        let count = std::sync::atomic::AtomicUsize::new(0);
        let result = Pool::new(2, &flag).run(
            0..1000,
            || (),
            |(), i| {
                count.fetch_add(1, Ordering::Relaxed);
                if i == 10 {
                    flag.store(true, Ordering::Relaxed);
                }
            },
        );
        assert_eq!(result, Err(Error::Interrupted));
        assert!(count.into_inner() < 1000);
    }
}
