//! One simulated specimen: foil, views, recordings and exact truth, from settings and one seed.
//!
//! Random numbers of geometry, look, alignment and each view's recording come from streams of their own: the same seed gives
//! the same foil at other tilts, in the other mode, or with another camera.

use ndarray::Array2;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::acquisition::{Acquisition, Recording};
use super::geometry::crystal::random_rotation;
use super::geometry::polyline::HalfSpace;
use super::geometry::{Crystal, Range, length_in_field_nm, resample, sample_foil};
use super::paradis::Network;
use super::parametric::{LookSettings, Specimen};
use super::physics;
use super::settings::{Mode, SimulateError, SimulateSettings};
use super::slab::{Cut, foil_from_network};
use super::visibility::{Beside, beside, followed};
use super::{Camera, Dislocation, Foil};
use crate::geometry::{Point2, Point3, Vector3};
use crate::truth::{ProjectedCurve, TrueView, Truth, ViewGeometry, ViewMap};

/// Side of the image that `foil.field_nm` speaks of, px.
const NOMINAL_SIDE_PX: f64 = 512.0;
/// A field is at most this many times the box of a network.
const MOST_BOXES: f64 = 3.0;
/// Below this g.b, and g.(b x u) / 8, a line shows no contrast of its own.
const LEAST_STRENGTH: f64 = 0.08;
/// Lines of a network may be this many times as long as those of a random foil at most; more cannot be told apart.
const CROWDED: f64 = 4.0;
/// Greatest distance of neighbouring points of the truth, px.
const SPACING_PX: f64 = 0.7;
/// Contrast that wanders from one side of a line to the other is averaged over this length along it, px (standard
/// deviation): no one draws such a line as a zigzag.
const CENTRE_LENGTH_PX: f64 = 4.0;

/// A specimen in its views.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The foil, nm.
    pub foil: Foil,
    /// Its truth in all views.
    pub truth: Truth,
    /// The views, in the order of the tilts.
    pub views: Vec<SampleView>,
    /// Side of a pixel of the first view, nm.
    pub pixel_size_nm: f64,
}

/// One view.
#[derive(Clone, Debug)]
pub struct SampleView {
    /// Where foil points (nm) land.
    pub camera: Camera,
    /// What was recorded.
    pub recording: Recording,
}

/// Where the lines come from.
#[derive(Clone, Copy, Debug)]
pub enum Lines<'a> {
    /// Random foils of the family.
    Random,
    /// Foils cut out of a network at random places and orientations.
    Network(&'a Network),
}

/// A foil with what its image depends on beside its lines.
struct Body {
    foil: Foil,
    boundaries: Vec<HalfSpace>,
    crystal: Option<Crystal>,
}

/// Noise-free image (about 1 on the background) and the curves in it.
struct Seen {
    image: Array2<f32>,
    curves: Vec<SeenCurve>,
}

/// A line in a noise-free image; lists are aligned with its points.
struct SeenCurve {
    core: Vec<Point2>,
    centre: Vec<Point2>,
    /// Relative to the background, without sign.
    contrast: Vec<f32>,
}

/// Makes the sample of a seed.
///
/// # Errors
/// Where the settings are not possible, or no foil can be cut from the network.
pub fn sample(settings: &SimulateSettings, lines: Lines<'_>, seed: u64) -> Result<Sample, SimulateError> {
    settings.validate()?;
    let stream = |number: u64| Pcg64::seed_from_u64(seed ^ number.wrapping_mul(0xd1b5_4a32_d192_ed03));
    let mut body = match lines {
        Lines::Random => random_body(settings, &mut stream(0)),
        Lines::Network(network) => cut_body(settings, network, &mut stream(0))?,
    };
    let pixel_size_nm = body.foil.size_nm[0] / settings.size_px as f64;
    body.foil.dislocations = resample(body.foil.dislocations, SPACING_PX * pixel_size_nm);
    let cameras = settings.alignment.random(&settings.tilts_deg, settings.size_px, 1.0 / pixel_size_nm, &mut stream(1));
    let seen = match settings.mode {
        Mode::Parametric => drawn(settings, &body, &cameras, pixel_size_nm, &mut stream(2)),
        Mode::Physics => diffracted(settings, &body, &cameras, pixel_size_nm, &mut stream(2))?,
    };
    let recordings = Acquisition::of_views(&mut stream(3), &settings.acquisition, cameras.len());
    let views: Vec<SampleView> = cameras
        .into_iter()
        .zip(&seen)
        .zip(recordings)
        .map(|((camera, seen), acquisition)| SampleView { camera, recording: acquisition.record(&seen.image) })
        .collect();
    let truth = truth(settings, &body.foil, &seen, &views, pixel_size_nm, seed);
    Ok(Sample { foil: body.foil, truth, views, pixel_size_nm })
}

/// Names of the views' files: left and right, or numbers.
pub fn view_names(count: usize) -> Vec<String> {
    match count {
        2 => ["left.tif", "right.tif"].map(str::to_owned).into(),
        _ => (0..count).map(|index| format!("view-{index:03}.tif")).collect(),
    }
}

fn random_body(settings: &SimulateSettings, rng: &mut Pcg64) -> Body {
    let mut foil = settings.foil.clone();
    foil.field_nm = field_nm(settings);
    let steepest = settings.tilts_deg.iter().fold(0.0_f64, |most, tilt| most.max(tilt.abs())).to_radians();
    foil.margin = foil.margin.max(0.5 * (1.0 / steepest.cos() - 1.0) + settings.alignment.shift);
    let sample = sample_foil(&foil, rng);
    Body { crystal: sample.crystals.first().copied(), foil: sample.foil, boundaries: sample.boundaries }
}

fn field_nm(settings: &SimulateSettings) -> Range {
    let scale = settings.size_px as f64 / NOMINAL_SIDE_PX;
    let Range { low, high } = settings.foil.field_nm;
    Range::new(low * scale, high * scale)
}

fn cut_body(settings: &SimulateSettings, network: &Network, rng: &mut Pcg64) -> Result<Body, SimulateError> {
    let size_nm = network.size_nm();
    // A field of many boxes would show the same lines again and again.
    let field_nm = field_nm(settings).sample_log(rng).min(MOST_BOXES * size_nm.max());
    let margin = 1.0 + 2.0 * settings.foil.margin;
    // About a node, so that there is something to see in networks that are mostly empty.
    if network.nodes.is_empty() {
        return Err(SimulateError::EmptyNetwork);
    }
    let node = &network.nodes[rng.random_range(0..network.nodes.len())];
    let thickness_nm = settings.foil.thickness_nm.sample(rng);
    let specimen_from_network = random_rotation(rng);
    let extent = [field_nm, field_nm, thickness_nm];
    let aside = Vector3::from_fn(|axis, _| 0.3 * extent[axis] * rng.random_range(-1.0..1.0));
    let cut = Cut {
        thickness_nm,
        size_nm: [field_nm * margin; 2],
        specimen_from_network,
        centre: node.position + specimen_from_network.inverse() * aside,
        spacing_nm: settings.foil.spacing_nm,
    };
    let mut foil = foil_from_network(network, &cut)?;
    foil.size_nm = [field_nm; 2];
    let length_nm: f64 = foil.dislocations.iter().map(|line| length_in_field_nm(line, foil.size_nm)).sum();
    let most_nm = CROWDED * settings.foil.field_lengths.high * field_nm;
    if length_nm > most_nm {
        // Both length and field are in proportion to the field: halving the field halves their ratio.
        let field_nm = field_nm * most_nm / length_nm;
        return Err(SimulateError::TooDense { lengths: length_nm / foil.size_nm[0], thickness_nm, field_nm });
    }
    Ok(Body { foil, boundaries: Vec::new(), crystal: None })
}

/// Draws the lines and everything else.
fn drawn(
    settings: &SimulateSettings,
    body: &Body,
    cameras: &[Camera],
    pixel_size_nm: f64,
    rng: &mut Pcg64,
) -> Vec<Seen> {
    let curves: Vec<Vec<Point3>> = body.foil.dislocations.iter().map(|line| in_px(line, pixel_size_nm)).collect();
    let specimen = specimen(settings, body, &curves, &settings.look, pixel_size_nm, rng);
    let views = cameras.iter().enumerate();
    views
        .map(|(index, camera)| {
            let view = specimen.view(&in_px_camera(camera, pixel_size_nm), index);
            let curves = view.lines.into_iter().zip(&body.foil.dislocations).map(|(line, dislocation)| {
                let mut curve = SeenCurve { core: line.core, centre: line.contrast_centre, contrast: line.contrast };
                curve.truncate(dislocation.points.len());
                curve
            });
            Seen { image: view.image, curves: curves.collect() }
        })
        .collect()
}

/// Two-beam images, and over them what is not a line.
fn diffracted(
    settings: &SimulateSettings,
    body: &Body,
    cameras: &[Camera],
    pixel_size_nm: f64,
    rng: &mut Pcg64,
) -> Result<Vec<Seen>, SimulateError> {
    let conditions = settings.conditions.random(&body.foil, body.crystal.as_ref(), rng);
    let others = specimen(settings, body, &[], &settings.look, pixel_size_nm, rng);
    let conditions: Vec<_> = cameras.iter().map(|_| settings.conditions.another_view(&conditions, rng)).collect();
    cameras
        .par_iter()
        .zip(conditions)
        .enumerate()
        .map(|(index, (camera, conditions))| {
            let picture = physics::image(&body.foil, &conditions, camera)?;
            let mean = picture.background.iter().map(|value| f64::from(*value)).sum::<f64>();
            let gain = picture.background.len() as f64 / mean.max(1e-9);
            let mut image = others.view(&in_px_camera(camera, pixel_size_nm), index).image;
            image.zip_mut_with(&picture.intensity, |value, intensity| *value *= (f64::from(*intensity) * gain) as f32);
            let curves = picture.truth.lines.iter().zip(&body.foil.dislocations).map(|(line, dislocation)| {
                let mut curve = diffracted_curve(line);
                hide_invisible(&mut curve, dislocation, &conditions.g_per_nm);
                curve
            });
            Ok(Seen { image, curves: curves.collect() })
        })
        .collect()
}

/// The centre of contrast as one would draw it: offsets from the core averaged along the line, weighted by contrast.
fn diffracted_curve(line: &physics::LineTruth) -> SeenCurve {
    let contrast = |point: &physics::CorePoint| point.contrast.map_or(0.0, |contrast| contrast.peak_to_peak.abs());
    let core: Vec<Point2> = line.points.iter().map(|point| point.core_px).collect();
    let reach = (3.0 * CENTRE_LENGTH_PX / SPACING_PX).ceil() as usize;
    let centre = (0..core.len())
        .map(|index| {
            let (mut sum, mut weight) = (0.0, 1e-6);
            for other in index.saturating_sub(reach)..(index + reach + 1).min(core.len()) {
                let distance = (core[other] - core[index]).norm() / CENTRE_LENGTH_PX;
                let share = (-0.5 * distance * distance).exp() * contrast(&line.points[other]);
                weight += share;
                sum += share * line.points[other].contrast.map_or(0.0, |contrast| contrast.offset_px);
            }
            core[index] + line.points[index].across * (sum / weight)
        })
        .collect();
    SeenCurve { centre, contrast: line.points.iter().map(|point| contrast(point) as f32).collect(), core }
}

/// Takes the contrast of other lines from stretches that have none of their own: with g.b = 0 a line is seen only where
/// g.(b x u) / 8 reaches 0.08 (Hirsch et al. 1965, section 7.5).
fn hide_invisible(curve: &mut SeenCurve, line: &Dislocation, g_per_nm: &Vector3) {
    let Some(burgers) = line.burgers_nm else { return };
    let last = line.points.len().saturating_sub(1);
    for (index, contrast) in curve.contrast.iter_mut().enumerate() {
        let along = line.points[(index + 1).min(last)] - line.points[index.saturating_sub(1)];
        let direction = along.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let residual = g_per_nm.dot(&burgers.cross(&direction)) / 8.0;
        if g_per_nm.dot(&burgers).abs().max(residual.abs()) < LEAST_STRENGTH {
            *contrast = 0.0;
        }
    }
}

fn specimen(
    settings: &SimulateSettings,
    body: &Body,
    curves: &[Vec<Point3>],
    look: &LookSettings,
    pixel_size_nm: f64,
    rng: &mut Pcg64,
) -> Specimen {
    let boundaries: Vec<HalfSpace> =
        body.boundaries.iter().map(|wall| HalfSpace { offset: wall.offset / pixel_size_nm, ..*wall }).collect();
    let thickness_px = body.foil.thickness_nm / pixel_size_nm;
    Specimen::new(curves, &boundaries, settings.size_px as f64, thickness_px, look, rng.random_range(0..u64::MAX))
}

/// The points of a line in px of the first view; those of closed lines come back to the first.
fn in_px(line: &Dislocation, pixel_size_nm: f64) -> Vec<Point3> {
    let closing = line.points.first().filter(|_| line.closed);
    line.points.iter().chain(closing).map(|point| point / pixel_size_nm).collect()
}

fn in_px_camera(camera: &Camera, pixel_size_nm: f64) -> Camera {
    Camera { scale: camera.scale * pixel_size_nm, ..*camera }
}

impl SeenCurve {
    fn truncate(&mut self, count: usize) {
        self.core.truncate(count);
        self.centre.truncate(count);
        self.contrast.truncate(count);
    }
}

fn truth(
    settings: &SimulateSettings,
    foil: &Foil,
    seen: &[Seen],
    views: &[SampleView],
    pixel_size_nm: f64,
    seed: u64,
) -> Truth {
    let geometry: Vec<ViewGeometry> = view_names(views.len())
        .into_iter()
        .zip(views)
        .map(|(name, view)| ViewGeometry {
            name,
            tilt_rad: view.camera.tilt_rad,
            shape: view.camera.shape,
            map: ViewMap {
                scale_px: view.camera.scale,
                axis_rad: view.camera.axis_rad,
                origin_px: view.camera.image_from_projection().isometry.translation.vector.into(),
            },
        })
        .collect();
    let mut truth = Truth::of_foil(foil, &geometry);
    truth.pixel_size_nm = Some(pixel_size_nm);
    truth.family = Some(settings.family.word().into());
    truth.source = Some(format!("tiltline simulate, {} mode, geometry seed {seed}", settings.mode.word()));
    for ((truth, seen), view) in truth.views.iter_mut().zip(seen).zip(views) {
        truth.visible_above_noise = Some(settings.visible_above_noise);
        let lines: Vec<&[Point2]> = seen.curves.iter().map(|curve| &curve.centre[..]).collect();
        let Beside { background, texture } = beside(&seen.image, &lines);
        let mut least = texture;
        least.zip_mut_with(&background, |texture, background| {
            let noise = (*texture * *texture + view.recording.noise.variance_at(*background)).sqrt();
            *texture = (settings.visible_above_noise as f32 * noise).max(settings.least_contrast as f32);
        });
        for (curve, seen) in truth.curves.iter_mut().zip(&seen.curves) {
            see(curve, seen, &least, &view.recording.valid);
        }
    }
    leave_out_of_frame(&mut truth);
    truth
}

/// `least`: the contrast that can be seen at each pixel.
fn see(curve: &mut ProjectedCurve, seen: &SeenCurve, least: &Array2<f32>, valid: &Array2<bool>) {
    let pixel = |point: &Point2| {
        let (column, row) = (point.x.round(), point.y.round());
        (column >= 0.0 && row >= 0.0).then_some([row as usize, column as usize])
    };
    let stands_out = |point: &Point2, contrast: f32| {
        let Some(pixel) = pixel(point) else { return false };
        valid.get(pixel).is_some_and(|valid| *valid) && least.get(pixel).is_some_and(|least| contrast >= *least)
    };
    let contrast = followed(&seen.centre, &seen.contrast);
    let visible = seen.centre.iter().zip(contrast).map(|(centre, contrast)| stands_out(centre, contrast));
    curve.visible = Some(visible.collect());
    curve.contrast.clone_from(&seen.centre);
    curve.core = Some(seen.core.clone());
}

/// Takes out curves that no view has a point of.
fn leave_out_of_frame(truth: &mut Truth) {
    let in_view = |view: &TrueView, label: &str| {
        view.curve(label).is_some_and(|curve| curve.contrast.iter().any(|point| view.contains(point)))
    };
    let kept: Vec<bool> =
        truth.curves.iter().map(|curve| truth.views.iter().any(|view| in_view(view, &curve.label))).collect();
    let mut keep = kept.iter();
    truth.curves.retain(|_| *keep.next().expect("one entry a curve"));
    for view in &mut truth.views {
        let mut keep = kept.iter();
        view.curves.retain(|_| *keep.next().expect("views of a foil have all of its curves, in order"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::Family;

    fn small(family: Family, mode: Mode) -> SimulateSettings {
        SimulateSettings { mode, size_px: 96, ..SimulateSettings::of_family(family) }
    }

    #[test]
    fn the_same_seed_gives_the_same_sample_with_any_number_of_threads() {
        for mode in [Mode::Parametric, Mode::Physics] {
            let settings = small(Family::Mixed, mode);
            let with = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| sample(&settings, Lines::Random, 11).unwrap())
            };
            let (one, three) = (with(1), with(3));
            assert_eq!(one.truth, three.truth);
            for (one, three) in one.views.iter().zip(&three.views) {
                assert_eq!(one.recording, three.recording);
            }
        }
    }

    /// A curve's 3D points land where each view says its core is, by the map and tilt that the truth itself carries.
    #[test]
    fn truth_projects_on_to_its_own_cores() {
        for family in Family::ALL {
            let sample = sample(&small(family, Mode::Parametric), Lines::Random, 5).unwrap();
            sample.truth.check().unwrap();
            for view in &sample.truth.views {
                let map = view.input_from_projection.unwrap();
                for (curve, seen) in sample.truth.curves.iter().zip(&view.curves) {
                    let core = seen.core.as_ref().unwrap();
                    for (point, core) in curve.points.as_ref().unwrap().iter().zip(core) {
                        let place = map.project(point, view.tilt_rad.unwrap());
                        assert!((place - core).norm() < 1e-6);
                    }
                }
            }
        }
    }

    #[test]
    fn other_tilts_and_the_other_mode_show_the_same_foil() {
        let drawn = small(Family::Cantor, Mode::Parametric);
        let one = sample(&drawn, Lines::Random, 7).unwrap().foil;
        let tilted = SimulateSettings { tilts_deg: vec![-6.0, 6.0], ..drawn.clone() };
        assert_eq!(sample(&tilted, Lines::Random, 7).unwrap().foil, one);
        assert_eq!(sample(&small(Family::Cantor, Mode::Physics), Lines::Random, 7).unwrap().foil, one);
        assert_ne!(sample(&drawn, Lines::Random, 8).unwrap().foil, one);
    }

    /// A line with g.b = 0 beside one that is seen must not be called visible for its neighbour's contrast.
    #[test]
    fn a_line_without_contrast_of_its_own_is_not_visible_beside_one_with() {
        let line = |burgers| Dislocation {
            points: (0..5).map(|i| Point3::new(0.0, f64::from(i), 0.0)).collect(),
            closed: false,
            burgers_nm: Some(burgers),
            plane_normal: None,
        };
        let g = Vector3::new(4.0, 0.0, 0.0);
        let seen = |burgers| {
            let points = vec![Point2::origin(); 5];
            let mut curve = SeenCurve { core: points.clone(), centre: points, contrast: vec![0.5; 5] };
            hide_invisible(&mut curve, &line(burgers), &g);
            curve.contrast[2] > 0.0
        };
        assert!(seen(Vector3::new(0.25, 0.0, 0.0)));
        // A screw along y: g.b = 0 and b x u = 0.
        assert!(!seen(Vector3::new(0.0, 0.25, 0.0)));
        // An edge with b along z: g.b = 0, g.(b x u) / 8 = -0.125.
        assert!(seen(Vector3::new(0.0, 0.0, 0.25)));
    }

    /// A short straight line in a large empty box is in view, wherever the foil is cut.
    #[test]
    fn foils_are_cut_where_a_network_has_lines() {
        let text = "dataFileVersion = 4\nnumFileSegments = 1\nminCoordinates = [\n-20000\n-20000\n-20000\n]\n\
            maxCoordinates = [\n20000\n20000\n20000\n]\nnodeCount = 2\ndataDecompType = 1\ndataDecompGeometry = [ 1 1 1 ]\n\
            nodalData =\n 0,0 0 0 0 1 7\n 0,1 1 0 0\n 0 0 1\n 0,1 2000 0 0 1 7\n 0,0 -1 0 0\n 0 0 1\n";
        let network = Network::parse(text, &Default::default()).unwrap();
        for seed in 0..8 {
            let sample = sample(&small(Family::Mixed, Mode::Parametric), Lines::Network(&network), seed).unwrap();
            assert!(!sample.truth.curves.is_empty(), "{seed}");
        }
    }

    /// Dark where the truth says a line is visible: the mean grey on centres of contrast is below that 8 px beside.
    #[test]
    fn visible_centres_of_contrast_are_darker_than_their_surroundings() {
        let mut settings = SimulateSettings::of_family(Family::Gan);
        // Lines alone: what lies over or beside them has a grey of its own.
        settings.look = LookSettings {
            bright: 0.0,
            boundary_families: 0.0,
            lamellae: 0.0,
            hair: 0.0,
            slip_traces: 0.0,
            debris: 0.0,
            ..settings.look
        };
        settings.acquisition.border = 0.0;
        let (mut on, mut beside, mut count) = (0.0, 0.0, 0.0);
        for seed in 0..4 {
            let sample = sample(&settings, Lines::Random, seed).unwrap();
            for (truth, view) in sample.truth.views.iter().zip(&sample.views) {
                let image = view.recording.image.view();
                for curve in &truth.curves {
                    for (index, ends) in curve.contrast.windows(2).enumerate().filter(|(i, _)| curve.is_visible(*i)) {
                        let along = (ends[1] - ends[0]).normalize();
                        let at = |offset: f64| {
                            let point =
                                curve.contrast[index] + crate::geometry::Vector2::new(-along.y, along.x) * offset;
                            crate::filter::sample_linear(&image, point.x, point.y)
                        };
                        if let (Some(here), Some(one), Some(other)) = (at(0.0), at(8.0), at(-8.0)) {
                            on += f64::from(here);
                            beside += 0.5 * f64::from(one + other);
                            count += 1.0;
                        }
                    }
                }
            }
        }
        assert!(count > 1000.0 && on < 0.9 * beside, "{on} {beside} {count}");
    }
}
