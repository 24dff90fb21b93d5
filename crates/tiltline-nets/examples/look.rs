//! What a detector sees and says: `look WEIGHTS OUT.png [SEED]` writes rows of input, true lines (grey: not known) and probability for
//! crops as training draws them.

use std::error::Error;
use std::path::Path;

use burn::tensor::Device;
use ndarray::{Array2, s};
use tiltline::export::png::write_grey;
use tiltline::simulate::geometry::Split;
use tiltline_nets::data::{DataSettings, Source, Task};
use tiltline_nets::infer::{Named, NetDetector};

const ROWS: u64 = 4;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [weights, out, rest @ ..] = &arguments[..] else { return Err("look WEIGHTS OUT.png [SEED]".into()) };
    let seed = rest.first().map_or(Ok(7), |seed| seed.parse())?;
    let detector = NetDetector::new(&Named::read(Path::new(weights))?, &Device::flex())?;
    let settings = DataSettings { batch: 2, ..DataSettings::default() };
    let source = Source::new(&settings, Task::Detector, seed, Split::Val)?;
    let side = settings.crop_px;
    let mut sheet = Array2::<u8>::zeros((ROWS as usize * side, 6 * side));
    for row in 0..ROWS {
        let batch = source.batch(row)?;
        for crop in 0..2 {
            let part = |values: &[f32]| {
                let values = values[crop * side * side..(crop + 1) * side * side].to_vec();
                Array2::from_shape_vec((side, side), values)
            };
            let image = part(&batch.left)?;
            let lines = part(&batch.left_lines)?.mapv(|line| if line.is_nan() { 0.5 } else { line });
            let probability = detector.probability_of_flattened(&image);
            for (place, map) in [image, lines, probability].iter().enumerate() {
                let (top, left) = (row as usize * side, (3 * crop + place) * side);
                let map = if place == 0 { map / 6.0 + 0.5 } else { map.clone() };
                let grey = map.mapv(|value| (255.0 * value.clamp(0.0, 1.0)) as u8);
                sheet.slice_mut(s![top..top + side, left..left + side]).assign(&grey);
            }
        }
    }
    write_grey(&sheet, &mut std::fs::File::create(out)?)?;
    Ok(())
}
