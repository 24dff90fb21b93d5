//! Tilts given by the user: a list, a range, or a file (`.rawtlt`, `.tlt`, `.mdoc`); degrees throughout.

use super::{ReadError, mdoc};

/// Most tilts a range may give.
const MAX_TILTS: f64 = 1e5;
/// Longest text that is read as tilts.
const MAX_TEXT_BYTES: u64 = 1 << 26;
/// Angles beyond this are no tilts.
const MAX_TILT_DEG: f64 = 180.0;
const FORMS: &str = "write a list (-4,4), a range START:END:STEP (-50:50:2) or a file (series.rawtlt, series.mdoc)";

/// Tilts in degrees from `LIST|START:END:STEP|FILE`.
///
/// A range includes its end where the step meets it. Numbers are finite and at most 180; there is at least one.
///
/// ```
/// use tiltline::io::parse_tilts;
/// assert_eq!(parse_tilts("-4,4")?, [-4.0, 4.0]);
/// assert_eq!(parse_tilts("-50:50:2")?.len(), 51);
/// # Ok::<(), tiltline::io::ReadError>(())
/// ```
pub fn parse_tilts(given: &str) -> Result<Vec<f64>, ReadError> {
    let fault = |what: String| ReadError::Tilts { given: given.to_owned(), what };
    let given_text = given.trim();
    if given_text.is_empty() {
        return Err(fault(format!("there is nothing; {FORMS}")));
    }
    if let Some(tilts) = parse_argument(given_text) {
        return tilts.map_err(fault);
    }
    // A file may be named with commas and colons; where every part is a number none is meant.
    if std::path::Path::new(given_text).exists() {
        return read_file(given_text);
    }
    let parts: Vec<&str> = given_text.split(',').collect();
    let odd = parts.iter().find(|part| number(part).is_none()).filter(|_| parts.len() > 1);
    let what = match odd {
        Some(odd) => format!("{odd:?} is not a number, and there is no such file"),
        None if given_text.contains(':') => "a range is three numbers, and there is no such file".to_owned(),
        None => "there is no such file".to_owned(),
    };
    Err(fault(format!("{what}; {FORMS}")))
}

/// Tilts of a list or a range; `None` where not every part is a number.
pub(super) fn parse_argument(text: &str) -> Option<Result<Vec<f64>, String>> {
    let numbers = |separator: char| text.split(separator).map(number).collect::<Option<Vec<f64>>>();
    let tilts = match (numbers(','), numbers(':').as_deref()) {
        (Some(list), _) => Ok(list),
        (None, Some(&[start, end, step])) => range(start, end, step),
        _ => return None,
    };
    Some(tilts.and_then(|tilts| check(&tilts).map(|()| tilts)))
}

fn number(text: &str) -> Option<f64> {
    text.trim().parse().ok()
}

/// Tilts of a text with one number a line, as `.rawtlt` and `.tlt` have it; empty lines and `#` comments are passed over.
pub fn parse_lines(text: &str) -> Result<Vec<f64>, String> {
    let mut tilts = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let tilt = line.parse().map_err(|_| format!("line {} is {line:?}, not one number in degrees", index + 1))?;
        tilts.push(tilt);
    }
    check(&tilts)?;
    Ok(tilts)
}

/// Tilts of a file: `.mdoc` where it has `TiltAngle` items, one number a line otherwise.
pub(super) fn read_file(path: &str) -> Result<Vec<f64>, ReadError> {
    let text = read_text(path)?;
    let tilts =
        if mdoc::is_mdoc(&text) { mdoc::parse(&text).and_then(|mdoc| mdoc.tilts_deg()) } else { parse_lines(&text) };
    tilts.map_err(|what| ReadError::Tilts { given: path.to_owned(), what })
}

/// Reads a text that is not absurdly long.
pub(super) fn read_text(path: &str) -> Result<String, ReadError> {
    let mut input = super::Input::open(path)?;
    if input.length > MAX_TEXT_BYTES {
        let what = format!("the file has {} bytes, more than {MAX_TEXT_BYTES}: it is no list of tilts", input.length);
        return Err(ReadError::Tilts { given: path.to_owned(), what });
    }
    let bytes = input.bytes_at(0, MAX_TEXT_BYTES)?;
    String::from_utf8(bytes).map_err(|_| {
        let what = "the file is no text; give a list of tilts, one a line, or a .mdoc file".to_owned();
        ReadError::Tilts { given: path.to_owned(), what }
    })
}

fn range(start: f64, end: f64, step: f64) -> Result<Vec<f64>, String> {
    if [start, end, step].iter().any(|value| !value.is_finite()) {
        return Err("start, end and step must be finite numbers of degrees".to_owned());
    }
    if step == 0.0 {
        return Err(format!("a step of 0 never gets from {start} to {end}"));
    }
    let steps = (end - start) / step;
    if steps < 0.0 {
        return Err(format!("a step of {step} leads away from {end}; write {start}:{end}:{}", -step));
    }
    if steps > MAX_TILTS {
        return Err(format!("a step of {step} gives {steps:.0} tilts, more than {MAX_TILTS}"));
    }
    // A billionth of a step forgives the rounding of decimal steps such as 0.1.
    let count = (steps + 1e-9).floor() as usize + 1;
    Ok((0..count).map(|index| start + index as f64 * step).collect())
}

/// What every list of tilts must meet.
pub(super) fn check(tilts: &[f64]) -> Result<(), String> {
    if tilts.is_empty() {
        return Err(format!("there are no tilts in it; {FORMS}"));
    }
    for (index, &tilt) in tilts.iter().enumerate() {
        if !tilt.is_finite() {
            return Err(format!("tilt {} is {tilt}; tilts are finite numbers of degrees", index + 1));
        }
        if tilt.abs() > MAX_TILT_DEG {
            return Err(format!("tilt {} is {tilt} degrees; tilts lie between -180 and 180", index + 1));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(given: &str) -> String {
        parse_tilts(given).unwrap_err().to_string()
    }

    #[test]
    fn lists_and_ranges() {
        assert_eq!(parse_tilts("-2.08, +2.08").unwrap(), [-2.08, 2.08]);
        assert_eq!(parse_tilts("7").unwrap(), [7.0]);
        assert_eq!(parse_tilts("0:5:2").unwrap(), [0.0, 2.0, 4.0]);
        assert_eq!(parse_tilts("4:-4:-4").unwrap(), [4.0, 0.0, -4.0]);
        assert_eq!(parse_tilts("3:3:1").unwrap(), [3.0]);
        // 0.1 is no binary fraction: 0.3 / 0.1 is a little below 3, and the end belongs to the range.
        assert_eq!(parse_tilts("0:0.3:0.1").unwrap().len(), 4);
    }

    #[test]
    fn what_is_wrong_is_said() {
        assert!(message("").contains("nothing"));
        assert!(message("1,nan").contains("tilt 2 is NaN"));
        assert!(message("inf").contains("finite"));
        assert!(message("0:nan:1").contains("finite"));
        assert!(message("-50:50:0").contains("step of 0"));
        assert!(message("-50:50:-2").contains("-50:50:2"));
        assert!(message("0:90:1e-9").contains("more than"));
        assert!(message("1,,2").contains("\"\""));
        assert!(message("1:2").contains("START:END:STEP"));
        assert!(message("200").contains("-180 and 180"));
        assert!(message("nowhere.rawtlt").contains("no such file"));
    }

    #[test]
    fn lines_are_one_number_each() {
        assert_eq!(parse_lines(" -4.00\r\n\n 4.00 # second\n").unwrap(), [-4.0, 4.0]);
        assert!(parse_lines("1\n2 3\n").unwrap_err().contains("line 2"));
        assert!(parse_lines("\n\n").unwrap_err().contains("no tilts"));
    }
}
