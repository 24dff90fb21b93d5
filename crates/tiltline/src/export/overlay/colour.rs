//! The colour map of depth: viridis (Smith, van der Walt and Firing 2015, matplotlib, CC0): perceptually uniform and safe
//! for colour-blind readers.

use crate::export::overlay::canvas::Rgb;

/// Seventeen evenly spaced colours of viridis.
const VIRIDIS: [Rgb; 17] = [
    [68, 1, 84],
    [72, 24, 106],
    [71, 45, 123],
    [66, 64, 134],
    [59, 82, 139],
    [51, 99, 141],
    [44, 114, 142],
    [38, 130, 142],
    [33, 145, 140],
    [31, 160, 136],
    [40, 174, 128],
    [63, 188, 115],
    [94, 201, 98],
    [132, 212, 75],
    [173, 220, 48],
    [216, 226, 25],
    [253, 231, 37],
];

/// Colour at a fraction of the range, 0 to 1; clipped outside.
pub fn viridis(fraction: f64) -> Rgb {
    let last = VIRIDIS.len() - 1;
    let at = fraction.clamp(0.0, 1.0) * last as f64;
    let index = (at as usize).min(last - 1);
    let t = at - index as f64;
    std::array::from_fn(|channel| {
        let (low, high) = (f64::from(VIRIDIS[index][channel]), f64::from(VIRIDIS[index + 1][channel]));
        (low * (1.0 - t) + high * t).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_map_grows_lighter_all_the_way() {
        let luma = |[r, g, b]: Rgb| 0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b);
        let steps: Vec<f64> = (0..=100).map(|step| luma(viridis(f64::from(step) / 100.0))).collect();
        assert!(steps.windows(2).all(|pair| pair[1] > pair[0]));
        assert_eq!(viridis(-3.0), [68, 1, 84]);
        assert_eq!(viridis(7.0), [253, 231, 37]);
    }
}
