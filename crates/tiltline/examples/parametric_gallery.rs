//! `cargo run --release --example parametric_gallery -- FOLDER [COUNT]`: left and right views of random specimens as PNG, side
//! by side, to look at beside real micrographs.
#![allow(clippy::print_stdout)]

use std::fs::File;
use std::path::Path;

use ndarray::{Array2, Axis, concatenate};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use tiltline::micrograph::Micrograph;
use tiltline::simulate::acquisition::{Acquisition, AcquisitionSettings};
use tiltline::simulate::parametric::{LookSettings, Specimen};
use tiltline::simulate::{Camera, Scene, SceneSettings};

fn main() {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().expect("a folder for the pictures");
    let count: u64 = arguments.next().map_or(6, |count| count.parse().expect("a number of pictures"));
    for seed in 0..count {
        let start = std::time::Instant::now();
        let scene = Scene::random(&SceneSettings { seed, curves: 12, specks: 0, ..SceneSettings::default() });
        let specimen = Specimen::new(&scene.curves, &[], 512.0, 120.0, &LookSettings::default(), seed);
        let views = [-4.0_f64, 4.0].map(|tilt_deg| {
            let camera = Camera { tilt_rad: tilt_deg.to_radians(), ..Camera::new([512, 512]) };
            let index = usize::from(tilt_deg > 0.0);
            let mut rng = Pcg64::seed_from_u64(seed * 2 + index as u64);
            let view = specimen.view(&camera, index);
            Acquisition::random(&mut rng, &AcquisitionSettings::default()).record(&view.image).image
        });
        println!("{seed}: {:.3} s", start.elapsed().as_secs_f64());
        let [left, right] = views.map(|image| Micrograph::new(image).normalised());
        let both = concatenate(Axis(1), &[left.view(), right.view()]).expect("both views have one shape");
        write(&Path::new(&folder).join(format!("pair_{seed}.png")), &both);
    }
}

fn write(path: &Path, image: &Array2<f32>) {
    let (height, width) = image.dim();
    let mut encoder = png::Encoder::new(File::create(path).expect("the folder exists"), width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    let bytes: Vec<u8> = image.iter().map(|value| (value * 255.0).clamp(0.0, 255.0) as u8).collect();
    encoder.write_header().and_then(|mut writer| writer.write_image_data(&bytes)).expect("the disk has space");
}
