//! Simulates the items of a planned data set into a folder: in any order, on all cores, each item whole or not at all. What is
//! already there and intact is kept, so that the same command goes on where it was interrupted.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rayon::prelude::*;

use super::item::{TEMPORARY, files, hashes, place};
use super::{Dataset, DatasetError, Item, MANIFEST, Manifest};
use crate::simulate::geometry::geometry_seed;
use crate::simulate::{Lines, sample};

/// What was done.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Made {
    /// Items simulated now.
    pub made: usize,
    /// Items that were there and intact.
    pub kept: usize,
    /// Items that were there but damaged, and were made again.
    pub mended: Vec<String>,
}

/// Makes the planned data set in `folder`; `progress(done, of)` is called after each item and stops the work by returning
/// false.
///
/// The result does not depend on the number of threads, nor on how often it was interrupted.
///
/// # Errors
/// Where the folder holds anything else, an item cannot be simulated or a file not be written. Nothing that was there is
/// lost.
pub fn make(
    plan: &Manifest,
    lines: Lines<'_>,
    folder: &Path,
    progress: &(dyn Fn(usize, usize) -> bool + Sync),
) -> Result<(Dataset, Made), DatasetError> {
    let io = |source| DatasetError::Io { path: folder.into(), source };
    let mut manifest = plan.clone();
    let mut made = Made::default();
    if folder.join(MANIFEST).is_file() {
        take_over(&mut manifest, folder, &mut made)?;
    } else {
        let occupied = fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some());
        if occupied || folder.is_file() {
            return Err(DatasetError::Foreign { folder: folder.into() });
        }
        fs::create_dir_all(folder).map_err(io)?;
        manifest.write(folder)?;
    }
    let missing: Vec<usize> =
        (0..manifest.items.len()).filter(|&index| manifest.items[index].files.is_empty()).collect();
    let count = manifest.items.len();
    made.kept = count - missing.len();
    made.made = missing.len() - made.mended.len();
    let plan = manifest.clone();
    let state = Mutex::new(State { manifest, done: made.kept, pause: Pause::new() });
    let stopped = AtomicBool::new(!progress(made.kept, count));
    let result = missing.into_par_iter().with_max_len(1).try_for_each(|index| {
        if stopped.load(Ordering::Relaxed) {
            return Err(DatasetError::Stopped);
        }
        let hashes = make_item(&plan, &plan.items[index], lines, folder)?;
        let mut state = state.lock().expect("no thread panics while it holds the lock");
        state.manifest.items[index].files = hashes;
        state.done += 1;
        state.note(folder)?;
        if !progress(state.done, count) {
            stopped.store(true, Ordering::Relaxed);
        }
        Ok(())
    });
    let State { manifest, done, .. } = state.into_inner().expect("no thread panics while it holds the lock");
    if let (Err(error), 0) = (&result, done)
        && !matches!(error, DatasetError::Stopped)
    {
        // Nothing was made: the folder is left as it was found, for a second try with other settings.
        fs::remove_file(folder.join(MANIFEST)).map_err(io)?;
        // A folder that is still in use stays.
        let _ = fs::remove_dir(folder);
    } else {
        manifest.write(folder)?;
    }
    result?;
    Ok((Dataset { folder: folder.into(), manifest }, made))
}

/// How far the work has come.
struct State {
    manifest: Manifest,
    done: usize,
    pause: Pause,
}

/// When the manifest is written again: not after each of ten thousand items.
struct Pause {
    last: Instant,
    least: Duration,
}

impl Pause {
    fn new() -> Self {
        Self { last: Instant::now(), least: Duration::ZERO }
    }
}

impl State {
    /// Writes the manifest, unless that was done a moment ago: an item that is not noted is made again, which costs less.
    fn note(&mut self, folder: &Path) -> Result<(), DatasetError> {
        if self.pause.last.elapsed() < self.pause.least {
            return Ok(());
        }
        let start = Instant::now();
        self.manifest.write(folder)?;
        // A twentieth of the time at most.
        self.pause = Pause { last: Instant::now(), least: 20 * start.elapsed() };
        Ok(())
    }
}

/// Takes the hashes of items that are there and intact from the manifest in the folder; items beyond the plan stay.
fn take_over(manifest: &mut Manifest, folder: &Path, made: &mut Made) -> Result<(), DatasetError> {
    let existing = Dataset::open(folder)?;
    if let Some(difference) = manifest.difference(&existing.manifest) {
        return Err(DatasetError::Other { folder: folder.into(), difference });
    }
    let checked: Vec<(Item, bool)> = existing
        .manifest
        .items
        .par_iter()
        .map(|item| (item.clone(), !item.files.is_empty() && existing.check_item(item).is_ok()))
        .collect();
    for (index, (item, intact)) in checked.into_iter().enumerate() {
        if !intact && !item.files.is_empty() {
            made.mended.push(item.name.clone());
        }
        let files = if intact { item.files.clone() } else { Default::default() };
        match manifest.items.get_mut(index) {
            Some(planned) => planned.files = files,
            // A longer set than asked for: what was planned once is finished with it.
            None => manifest.items.push(Item { files, ..item }),
        }
    }
    // What an interrupted run left.
    let io = |source| DatasetError::Io { path: folder.into(), source };
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.is_dir() && path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(TEMPORARY)) {
            fs::remove_dir_all(&path).map_err(io)?;
        }
    }
    Ok(())
}

/// Simulates one item and moves it into place when it is complete.
fn make_item(
    plan: &Manifest,
    item: &Item,
    lines: Lines<'_>,
    folder: &Path,
) -> Result<BTreeMap<String, String>, DatasetError> {
    let unplanned = |what: &str| DatasetError::Manifest {
        path: folder.join(MANIFEST),
        problem: format!("item {} has no {what}: only simulated items can be made", item.name),
    };
    let settings =
        item.settings.as_ref().and_then(|name| plan.settings.get(name)).ok_or_else(|| unplanned("settings"))?;
    let seed = plan.seed.ok_or_else(|| unplanned("seed"))?;
    let foil = item.foil.ok_or_else(|| unplanned("foil number"))?;
    let sample = sample(settings, lines, geometry_seed(item.split, (seed << 32) | u64::from(foil)))?;
    let files = files(&sample, item.pair)?;
    let target = folder.join(&item.name);
    if target.exists() {
        // Damaged, or complete but not yet noted when the program was stopped.
        fs::remove_dir_all(&target).map_err(|source| DatasetError::Io { path: target.clone(), source })?;
    }
    place(&files, folder, &item.name)?;
    Ok(hashes(&files))
}
