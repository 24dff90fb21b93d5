//! IMOD's `.xf` transforms: a line a section, `a11 a12 a21 a22 dx dy`.
//!
//! As IMOD's documentation of `xf2rotmagstr` has it: `x' = a11 (x - xci) + a12 (y - yci) + dx + xco` and `y' = a21 (x - xci) +
//! a22 (y - yci) + dy + yco`, from the position in the original image to that in the aligned one, about the centres of both;
//! y is up there. Here y is down: the off-diagonal elements and dy change their sign.

use nalgebra::Matrix2;

use super::{ReadError, tilts};
use crate::geometry::Vector2;

/// A transform of one section in our axes (y down): `aligned - aligned centre = matrix (original - centre) + shift`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionTransform {
    /// Turn, magnification and stretch.
    pub matrix: Matrix2<f64>,
    /// Shift, px.
    pub shift: Vector2,
}

impl SectionTransform {
    /// The six numbers of a line, y up.
    pub fn numbers(&self) -> [f64; 6] {
        let m = &self.matrix;
        // Adding zero turns -0 into 0.
        [m[(0, 0)], -m[(0, 1)], -m[(1, 0)], m[(1, 1)], self.shift.x, -self.shift.y].map(|value| value + 0.0)
    }

    /// From the six numbers of a line.
    pub fn from_numbers([a11, a12, a21, a22, dx, dy]: [f64; 6]) -> Self {
        Self { matrix: Matrix2::new(a11, -a12, -a21, a22), shift: Vector2::new(dx, -dy) }
    }
}

/// Transforms of a text.
///
/// # Errors
/// What is wrong with which line.
pub fn parse(text: &str) -> Result<Vec<SectionTransform>, String> {
    let mut transforms = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let numbers: Vec<f64> = line
            .split([' ', '\t', ','])
            .filter(|word| !word.is_empty())
            .map(|word| word.parse().ok().filter(|value: &f64| value.is_finite()))
            .collect::<Option<_>>()
            .ok_or_else(|| format!("line {} is {line:?}; a transform is six numbers", index + 1))?;
        let numbers: [f64; 6] = numbers.try_into().map_err(|given: Vec<f64>| {
            format!("line {} has {} numbers; a transform has six", index + 1, given.len())
        })?;
        let transform = SectionTransform::from_numbers(numbers);
        if transform.matrix.determinant().abs() < 1e-6 {
            return Err(format!("line {}: {line:?} maps the image on to a line", index + 1));
        }
        transforms.push(transform);
    }
    if transforms.is_empty() {
        return Err("there is no transform in it".to_owned());
    }
    Ok(transforms)
}

/// Reads an `.xf` file, one transform a section.
///
/// # Errors
/// Where it cannot be read or a line is no transform.
pub fn read(path: &str) -> Result<Vec<SectionTransform>, ReadError> {
    let text = tilts::read_text(path)?;
    parse(&text).map_err(|what| ReadError::Corrupt { path: path.to_owned(), format: "transform (.xf)", what })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In IMOD a positive rotation is counterclockwise with y up: a11 = cos, a12 = -sin. A point to the right of the centre
    /// goes up on the screen, that is to smaller y here; a positive dy moves the image up.
    #[test]
    fn a_counterclockwise_turn_moves_the_right_side_up_the_screen() {
        let transforms = parse("   0.0000000  -1.0000000   1.0000000   0.0000000       2.000       3.000\n").unwrap();
        let moved = transforms[0].matrix * Vector2::new(10.0, 0.0) + transforms[0].shift;
        assert_eq!(moved, Vector2::new(2.0, -13.0));
        assert_eq!(transforms[0].numbers(), [0.0, -1.0, 1.0, 0.0, 2.0, 3.0]);
    }

    #[test]
    fn what_is_no_transform_is_named() {
        assert!(parse("1 0 0 1 0\n").unwrap_err().contains("line 1 has 5"));
        assert!(parse("1 0 0 1 0 x\n").unwrap_err().contains("six numbers"));
        assert!(parse("\n").unwrap_err().contains("no transform"));
        assert!(parse("1 0 2 0 0 0\n").unwrap_err().contains("on to a line"));
    }
}
