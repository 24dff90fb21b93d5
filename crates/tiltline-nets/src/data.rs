//! Training data without tensors: examples on a rectified grid, random crops of them, batches in order.
//!
//! A batch is a pure function of settings, seed and step: whatever the number of threads, and for a resumed run. Examples come
//! from the simulator (foils of the training split only) and from data sets. Several crops are taken of each example; the crops
//! of a window of examples are shuffled, so that a batch mixes foils although each is made once.

mod augment;
mod example;
mod queue;

#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock};

use rand::RngExt;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use tiltline::dataset::{Dataset, DatasetError, Item};
use tiltline::simulate::geometry::Split;
use tiltline::simulate::{Family, SimulateError};

pub use augment::{AugmentSettings, Crop};
pub use example::Example;
pub use queue::Queue;

/// Examples whose crops are shuffled together.
const WINDOW: u64 = 8;
/// Sets of training foils have seeds of their own below those of published sets.
const MOST_SEED: u64 = 1 << 29;

/// What the batches are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Single images, of either view: only the left half of a batch is filled.
    Detector,
    /// Pairs.
    Matcher,
}

/// Where batches come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DataSettings {
    /// Families that are simulated, all equally often; none for data sets only.
    pub families: Vec<Family>,
    /// Share of simulated pairs that are diffracted, which takes ten times as long as drawing.
    pub physics: f64,
    /// How much more of what is not a line (boundaries, lamellae, slip traces, dirt) there is than the families have.
    pub clutter: f64,
    /// Mean number of families of planar faults with fringes in a simulated pair; the families have none of their own.
    pub faults: f64,
    /// Side of a simulated image, px.
    pub simulated_px: usize,
    /// Smallest and largest angle between the views of a simulated pair, degrees.
    pub phi_deg: [f64; 2],
    /// Largest tilt of the middle between the views of a simulated pair, degrees.
    pub mid_tilt_deg: f64,
    /// Folders of data sets whose training items are used beside the simulator.
    pub folders: Vec<PathBuf>,
    /// Share of examples from those folders, if there are any.
    pub folder_share: f64,
    /// Side of a crop, px.
    pub crop_px: usize,
    /// Crops in a batch.
    pub batch: usize,
    /// Crops that are taken of each example.
    pub crops_per_example: u64,
    /// Different examples that are ever seen; 0 for new ones without end.
    pub examples: u64,
    /// Threads that prepare batches beside the training.
    pub threads: usize,
    /// How crops are changed.
    pub augment: AugmentSettings,
}

impl Default for DataSettings {
    fn default() -> Self {
        Self {
            families: vec![Family::Mixed, Family::Gan, Family::Tial, Family::Cantor],
            physics: 0.12,
            clutter: 1.8,
            faults: 0.35,
            simulated_px: 512,
            phi_deg: [2.0, 12.0],
            mid_tilt_deg: 15.0,
            folders: Vec::new(),
            folder_share: 0.5,
            crop_px: 224,
            batch: 4,
            crops_per_example: 16,
            examples: 0,
            threads: 1,
            augment: AugmentSettings::default(),
        }
    }
}

/// Why there is no data.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// The simulator.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// A data set.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// An item that cannot be used.
    #[error("{item} cannot be trained on: {why}")]
    Item {
        /// Its folder.
        item: PathBuf,
        /// Why.
        why: String,
    },
    /// Pairs without a common geometry, and nothing else to learn from.
    #[error("none of the {count} pairs can be rectified: there is nothing to train a matcher on")]
    NotRectified {
        /// How many there are.
        count: usize,
    },
    /// A setting that is not possible.
    #[error("{name} is {value}; it must be {wanted}")]
    Setting {
        /// The key.
        name: &'static str,
        /// What was given.
        value: String,
        /// What is possible.
        wanted: &'static str,
    },
    /// The thread that prepares batches is gone.
    #[error("the thread that prepares batches stopped")]
    Stopped,
}

/// Crops as flat arrays, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// Crops.
    pub count: usize,
    /// Side of each, px.
    pub side: usize,
    /// Left images `[count, side, side]`, flattened.
    pub left: Vec<f32>,
    /// Right images; empty for [`Task::Detector`].
    pub right: Vec<f32>,
    /// Lines of the left images: 1, 0, or NaN where it is not known.
    pub left_lines: Vec<f32>,
    /// Lines of the right images; empty for [`Task::Detector`].
    pub right_lines: Vec<f32>,
    /// Disparities on the left grid, px; NaN where not known; empty for [`Task::Detector`].
    pub disparity: Vec<f32>,
}

impl Batch {
    fn of(crops: Vec<Crop>, task: Task) -> Self {
        let (count, side) = (crops.len(), crops.first().map_or(0, |crop| crop.images[0].nrows()));
        let flat = |part: &dyn Fn(&Crop) -> Vec<f32>| crops.iter().flat_map(part).collect::<Vec<f32>>();
        let view = |view: usize, lines: bool| {
            let map = move |crop: &Crop| {
                let maps = if lines { &crop.lines } else { &crop.images };
                maps[view].iter().copied().collect::<Vec<f32>>()
            };
            flat(&map)
        };
        let pair = task == Task::Matcher;
        let only = |values: Vec<f32>| if pair { values } else { Vec::new() };
        Self {
            count,
            side,
            left: view(0, false),
            right: only(view(1, false)),
            left_lines: view(0, true),
            right_lines: only(view(1, true)),
            disparity: only(flat(&|crop: &Crop| crop.disparity.iter().copied().collect())),
        }
    }
}

/// Makes the batch of any step.
pub struct Source {
    settings: DataSettings,
    task: Task,
    seed: u64,
    split: Split,
    items: Vec<(usize, Item)>,
    sets: Vec<Dataset>,
    /// Folders of pairs that no matcher can learn from, in the order in which that was seen.
    left_out: Mutex<Vec<PathBuf>>,
    cache: Mutex<Vec<(u64, Made)>>,
}

/// An example that is made once, by whoever needs it first.
type Made = Arc<OnceLock<Result<Arc<Example>, Arc<DataError>>>>;

impl Source {
    /// The source of a run; `split` is `Train`, or `Val` for validation.
    ///
    /// # Errors
    /// Where settings are not possible, or a data set cannot be opened or has no items of the split.
    pub fn new(settings: &DataSettings, task: Task, seed: u64, split: Split) -> Result<Self, DataError> {
        settings.validate()?;
        let sets: Vec<Dataset> = settings.folders.iter().map(Dataset::open).collect::<Result<_, _>>()?;
        let items: Vec<(usize, Item)> = sets
            .iter()
            .enumerate()
            .flat_map(|(set, data)| data.manifest.items.iter().map(move |item| (set, item.clone())))
            .filter(|(_, item)| item.split == split)
            .collect();
        if items.is_empty() && settings.families.is_empty() {
            let value = format!("{} folders without an item of the split {}", sets.len(), split.word());
            return Err(DataError::Setting { name: "folders", value, wanted: "folders with such items" });
        }
        let (settings, cache, left_out) = (settings.clone(), Mutex::default(), Mutex::default());
        Ok(Self { settings, task, seed: seed % MOST_SEED, split, items, sets, left_out, cache })
    }

    /// Folders of the pairs that were left out so far, since they cannot be rectified.
    pub fn left_out(&self) -> Vec<PathBuf> {
        self.left_out.lock().expect("no thread panics while it holds the lock").clone()
    }

    /// The batch of a step.
    ///
    /// # Errors
    /// Where an example cannot be made.
    pub fn batch(&self, step: u64) -> Result<Batch, DataError> {
        let first = step * self.settings.batch as u64;
        let crops = (first..first + self.settings.batch as u64).map(|index| self.crop(index));
        Ok(Batch::of(crops.collect::<Result<_, _>>()?, self.task))
    }

    fn rng(&self, stream: u64, index: u64) -> Pcg64 {
        Pcg64::new((u128::from(self.seed) << 64) | u128::from(index), (u128::from(stream) << 8) | self.split as u128)
    }

    fn crop(&self, index: u64) -> Result<Crop, DataError> {
        let per_window = WINDOW * self.settings.crops_per_example;
        let (window, place) = (index / per_window, index % per_window);
        let mut order: Vec<u64> = (0..per_window).collect();
        order.shuffle(&mut self.rng(0, window));
        let number = window * WINDOW + order[place as usize] % WINDOW;
        let example = self.example(number.checked_rem(self.settings.examples).unwrap_or(number))?;
        Ok(Crop::random(&example, self.task, self.settings.crop_px, &self.settings.augment, &mut self.rng(1, index)))
    }

    /// An example by number, made or remembered.
    fn example(&self, number: u64) -> Result<Arc<Example>, DataError> {
        let made = {
            let mut cache = self.cache.lock().expect("no thread panics while it holds the lock");
            match cache.iter().find(|(known, _)| *known == number) {
                Some((_, made)) => Arc::clone(made),
                None => {
                    let made = Made::default();
                    cache.push((number, Arc::clone(&made)));
                    if cache.len() > 3 * WINDOW as usize {
                        cache.remove(0);
                    }
                    made
                }
            }
        };
        let made = made.get_or_init(|| self.make(number).map(Arc::new).map_err(Arc::new));
        match made {
            Ok(example) => Ok(Arc::clone(example)),
            Err(error) => {
                Err(DataError::Item { item: PathBuf::from(format!("example {number}")), why: error.to_string() })
            }
        }
    }

    fn make(&self, number: u64) -> Result<Example, DataError> {
        let mut rng = self.rng(2, number);
        let share = if self.settings.families.is_empty() { 1.0 } else { self.settings.folder_share };
        if !self.items.is_empty() && rng.random_range(0.0..1.0) < share {
            match self.of_an_item(&mut rng)? {
                Some(example) => return Ok(example),
                None if self.settings.families.is_empty() => {
                    return Err(DataError::NotRectified { count: self.items.len() });
                }
                None => (),
            }
        }
        Example::simulated(&self.settings, (self.seed << 32) | number, self.split, &mut rng)
    }
}

impl Source {
    /// One of the items that can be used, at random; `None` where none can.
    fn of_an_item(&self, rng: &mut Pcg64) -> Result<Option<Example>, DataError> {
        let mut order: Vec<usize> = (0..self.items.len()).collect();
        // The first is drawn as if it were the only one.
        let first = rng.random_range(0..order.len());
        order.swap(0, first);
        order[1..].shuffle(rng);
        for index in order {
            let (set, item) = &self.items[index];
            let set = &self.sets[*set];
            let folder = set.folder.join(&item.name);
            if self.left_out().contains(&folder) {
                continue;
            }
            if let Some(example) = Example::of_item(set, item, self.task)? {
                return Ok(Some(example));
            }
            let mut left_out = self.left_out.lock().expect("no thread panics while it holds the lock");
            if !left_out.contains(&folder) {
                left_out.push(folder);
            }
        }
        Ok(None)
    }
}

impl DataSettings {
    /// Checks that crops have sides that networks can take.
    ///
    /// # Errors
    /// Where they have not.
    pub fn fits(&self, multiple: usize) -> Result<(), DataError> {
        if self.crop_px.is_multiple_of(multiple) {
            return Ok(());
        }
        let value = format!("{}, and the networks take multiples of {multiple}", self.crop_px);
        Err(DataError::Setting { name: "crop_px", value, wanted: "a multiple of that" })
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first that is not possible.
    pub fn validate(&self) -> Result<(), DataError> {
        let wrong = |name, value: String, wanted| Err(DataError::Setting { name, value, wanted });
        let share = |value: f64| (0.0..=1.0).contains(&value);
        if !share(self.physics) {
            return wrong("physics", self.physics.to_string(), "0 to 1");
        }
        if !(0.0..=10.0).contains(&self.clutter) {
            return wrong("clutter", self.clutter.to_string(), "0 to 10");
        }
        if !(0.0..=10.0).contains(&self.faults) {
            return wrong("faults", self.faults.to_string(), "0 to 10");
        }
        if !share(self.folder_share) {
            return wrong("folder_share", self.folder_share.to_string(), "0 to 1");
        }
        if !(32..=2048).contains(&self.crop_px) || !self.crop_px.is_multiple_of(16) {
            return wrong("crop_px", self.crop_px.to_string(), "a multiple of 16 from 32 to 2048");
        }
        if self.simulated_px < self.crop_px {
            return wrong("simulated_px", self.simulated_px.to_string(), "crop_px or more");
        }
        if self.batch == 0 || self.crops_per_example == 0 {
            return wrong("batch", self.batch.to_string(), "1 or more, and so must be crops_per_example");
        }
        let [low, high] = self.phi_deg;
        if !(low > 0.0 && high >= low && high <= 60.0 && (0.0..=60.0).contains(&self.mid_tilt_deg)) {
            return wrong("phi_deg", format!("{:?}", self.phi_deg), "two angles above 0 and up to 60 degrees");
        }
        self.augment.validate()
    }
}

/// A pair of a data set as a batch of one: rectified as the main job does it, the largest square in its middle whose sides suit every
/// network, disparities as they are. `None` where it cannot be rectified.
///
/// # Errors
/// Where its files cannot be read.
pub fn whole(set: &Dataset, item: &Item) -> Result<Option<Batch>, DataError> {
    let Some(example) = Example::rectified_item(set, item)? else { return Ok(None) };
    Ok(Some(Batch::of(vec![Crop::middle(&example)], Task::Matcher)))
}

/// Batches of one crop each from foils that are never trained on, the same at every call: little changed, so that scores are
/// those of plain images.
///
/// # Errors
/// As for [`Source::batch`].
pub fn validation(settings: &DataSettings, task: Task, count: usize) -> Result<Vec<Batch>, DataError> {
    let plain = DataSettings {
        batch: 1,
        crops_per_example: 1,
        // Multiples of 64 suit every network.
        crop_px: settings.crop_px.max(256).min(settings.simulated_px).max(64) / 64 * 64,
        augment: AugmentSettings::none(),
        ..settings.clone()
    };
    // Folders without validation items are validated on simulated foils.
    let source = Source::new(&plain, task, 0, Split::Val).or_else(|_| {
        let families = DataSettings::default().families;
        Source::new(&DataSettings { folders: Vec::new(), families, ..plain.clone() }, task, 0, Split::Val)
    })?;
    (0..count as u64).map(|step| source.batch(step)).collect()
}
