//! Batches prepared on spare threads, handed over in the order of their steps.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{JoinHandle, spawn};

use tiltline::simulate::geometry::Split;

use super::{Batch, DataError, DataSettings, Source, Task};

/// Batches that each thread may be ahead.
const AHEAD: usize = 4;

/// A queue of batches. Thread `t` of `n` makes every n-th batch; they are taken in turn.
pub struct Queue {
    batches: Vec<Receiver<Result<Batch, DataError>>>,
    next: usize,
    source: Arc<Source>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Queue {
    /// Starts to prepare the batches of a run from step `first` on.
    ///
    /// # Errors
    /// As for [`Source::new`].
    pub fn start(settings: &DataSettings, task: Task, seed: u64, first: u64) -> Result<Self, DataError> {
        let source = Arc::new(Source::new(settings, task, seed, Split::Train)?);
        let stop = Arc::new(AtomicBool::new(false));
        let count = settings.threads.max(1);
        let (mut batches, mut threads) = (Vec::new(), Vec::new());
        for thread in 0..count {
            let (sender, receiver) = sync_channel(AHEAD);
            let (source, stop) = (Arc::clone(&source), Arc::clone(&stop));
            let steps = (first + thread as u64..).step_by(count);
            threads.push(spawn(move || fill(&source, &sender, steps, &stop)));
            batches.push(receiver);
        }
        Ok(Self { batches, next: 0, source, stop, threads })
    }

    /// Folders of the pairs that were left out so far, since they cannot be rectified.
    pub fn left_out(&self) -> Vec<PathBuf> {
        self.source.left_out()
    }

    /// The next batch.
    ///
    /// # Errors
    /// Where it could not be made.
    pub fn next_batch(&mut self) -> Result<Batch, DataError> {
        let turn = self.next % self.batches.len();
        self.next += 1;
        self.batches[turn].recv().unwrap_or(Err(DataError::Stopped))
    }
}

fn fill(
    source: &Source,
    sender: &SyncSender<Result<Batch, DataError>>,
    steps: impl Iterator<Item = u64>,
    stop: &AtomicBool,
) {
    for step in steps {
        if stop.load(Ordering::Relaxed) || sender.send(source.batch(step)).is_err() {
            return;
        }
    }
}

impl Drop for Queue {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // Without receivers every waiting thread goes on, finds no one to send to, and ends.
        self.batches.clear();
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so itself; there is nothing to add here.
            let _ = thread.join();
        }
    }
}
