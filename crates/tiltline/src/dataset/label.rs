//! Brings a stereo pair that was labelled by hand in LabelMe into a data set: copies of both images as they are, a truth without
//! 3D, and the hashes. This is the form real annotated images are trained on and scored against in.

use std::fs;
use std::path::Path;

use super::item::{self, Files};
use super::{DatasetError, Item, MANIFEST, Manifest};
use crate::io::read_micrograph;
use crate::simulate::geometry::Split;
use crate::truth::{LabelWarning, import_labelme};

/// A labelled pair. Rows of both images are taken as epipolar lines: label rectified images.
#[derive(Clone, Debug)]
pub struct LabelledPair<'a> {
    /// Name of the item: a folder in the data set.
    pub name: &'a str,
    /// Left and right image.
    pub images: [&'a Path; 2],
    /// The LabelMe files of left and right.
    pub labels: [&'a Path; 2],
    /// Tilts of left and right in degrees, where known.
    pub tilts_deg: Option<[f64; 2]>,
    /// Side of a pixel of the left image, where known.
    pub pixel_size_nm: Option<f64>,
    /// Look of the images, for scores by family.
    pub family: Option<String>,
    /// What it is for.
    pub split: Split,
}

/// Adds a labelled pair to the data set in `folder`, which is made where it does not exist.
///
/// # Errors
/// Where an item of that name is there, an image or label file cannot be read, or image and labels differ in size. Nothing
/// is written then.
pub fn add_labelled(folder: &Path, pair: &LabelledPair<'_>) -> Result<Vec<LabelWarning>, DatasetError> {
    let io = |path: &Path| {
        let path = path.to_owned();
        move |source| DatasetError::Io { path, source }
    };
    let path = folder.join(MANIFEST);
    let mut manifest = if path.is_file() {
        Manifest::read(&path)?
    } else if fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(DatasetError::Foreign { folder: folder.into() });
    } else {
        Manifest::empty()
    };
    let target = folder.join(pair.name);
    if target.exists() || manifest.items.iter().any(|item| item.name == pair.name) {
        let problem = format!("there is an item {} already; give another name", pair.name);
        return Err(DatasetError::Manifest { path, problem });
    }
    let (mut truth, warnings) = import_labelme(pair.labels[0], pair.labels[1], pair.tilts_deg)?;
    truth.pixel_size_nm = pair.pixel_size_nm;
    truth.family.clone_from(&pair.family);
    truth.source = Some("LabelMe".into());
    let mut files = Files::new();
    for (index, (view, image)) in truth.views.iter_mut().zip(pair.images).enumerate() {
        let pixels = read_micrograph(&image.to_string_lossy())?.pixels;
        let (rows, columns) = pixels.dim();
        if (rows, columns) != (view.height, view.width) {
            let (label_columns, label_rows) = (view.width, view.height);
            return Err(DatasetError::ImageSize { path: image.into(), columns, rows, label_columns, label_rows });
        }
        let extension =
            image.extension().map_or_else(String::new, |extension| format!(".{}", extension.to_string_lossy()));
        view.name = format!("{}{extension}", ["left", "right"][index]);
        files.push((view.name.clone(), fs::read(image).map_err(io(image))?));
    }
    files.extend(item::drawn_files(&truth, [0, 1])?);
    fs::create_dir_all(folder).map_err(io(folder))?;
    manifest.items.push(Item {
        name: pair.name.into(),
        split: pair.split,
        truth: "truth.json".into(),
        pair: [0, 1],
        settings: None,
        foil: None,
        files: item::hashes(&files),
    });
    manifest.validate(&path)?;
    item::place(&files, folder, pair.name)?;
    manifest.write(folder)?;
    Ok(warnings)
}
