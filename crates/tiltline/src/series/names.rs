//! Tilts of a folder of images: from a table (CSV) or from the files' names.

use std::collections::HashMap;
use std::path::Path;

use super::SeriesError;

/// Beyond this no stage tilts.
const MAX_TILT_DEG: f64 = 90.0;

/// Tilts in degrees by file name from the text of a table: a row a view, file and tilt; a header line, comments after `#` and
/// further columns are allowed. Comma, semicolon or tab.
pub(super) fn parse_table(text: &str, path: &Path) -> Result<HashMap<String, f64>, SeriesError> {
    let fault = |what: String| SeriesError::Table { path: path.display().to_string(), what };
    let mut tilts = HashMap::new();
    let mut columns = None;
    for (index, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim().trim_start_matches('\u{feff}');
        if line.is_empty() {
            continue;
        }
        let cells: Vec<&str> = line.split([',', ';', '\t']).map(|cell| cell.trim().trim_matches('"')).collect();
        if columns.is_none() {
            let lower: Vec<String> = cells.iter().map(|cell| cell.to_lowercase()).collect();
            let column = |words: [&str; 3]| lower.iter().position(|cell| words.iter().any(|word| cell.contains(word)));
            let (file, tilt) = (column(["file", "name", "image"]), column(["tilt", "angle", "alpha"]));
            if let (Some(file), Some(tilt)) = (file, tilt) {
                columns = Some((file, tilt));
                continue;
            }
            columns = Some((0, 1));
        }
        let (file, tilt) = columns.unwrap_or((0, 1));
        let (Some(&name), Some(value)) = (cells.get(file), cells.get(tilt)) else {
            return Err(fault(format!("line {} is {line:?}; write FILE,TILT", index + 1)));
        };
        let value: f64 = match value.parse() {
            Ok(value) if f64::abs(value) <= MAX_TILT_DEG => value,
            _ => return Err(fault(format!("line {}: {value:?} is no tilt in degrees", index + 1))),
        };
        if tilts.insert(name.to_owned(), value).is_some() {
            return Err(fault(format!("line {}: {name} is there twice", index + 1)));
        }
    }
    if tilts.is_empty() {
        return Err(fault("there is no row in it; write FILE,TILT in each".to_owned()));
    }
    Ok(tilts)
}

/// Tilts in degrees from the names of the images, in their order; `None` where the names do not tell.
///
/// The n-th number of every name is taken as the tilt where those numbers differ, are at most 90, and look like tilts: with
/// a plus or both signs, with decimals, or followed by "deg". A counter (`view-001`) does not.
///
pub(super) fn tilts_of_names(names: &[String]) -> Option<Vec<f64>> {
    let numbers: Vec<Vec<Number>> = names.iter().map(|name| numbers(stem(name))).collect();
    let places = numbers.iter().map(Vec::len).min()?;
    // The last number first: counters and magnifications come before.
    let candidates = (0..places).rev().filter_map(|place| {
        let at: Vec<&Number> = numbers.iter().map(|name| &name[name.len() - places + place]).collect();
        let values: Vec<f64> = at.iter().map(|number| number.value).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let distinct = sorted.windows(2).all(|pair| pair[1] > pair[0]);
        let possible = values.iter().all(|value| value.abs() <= MAX_TILT_DEG);
        let signs = at.iter().any(|number| number.plus) || (sorted[0] < 0.0 && sorted[sorted.len() - 1] > 0.0);
        let marked = signs || at.iter().any(|number| number.decimals || number.degrees);
        (distinct && possible && marked).then_some(values)
    });
    candidates.into_iter().next()
}

fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// A number in a name.
struct Number {
    value: f64,
    plus: bool,
    decimals: bool,
    degrees: bool,
}

fn numbers(text: &str) -> Vec<Number> {
    let bytes = text.as_bytes();
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        if !bytes[at].is_ascii_digit() {
            at += 1;
            continue;
        }
        let start = at;
        while at < bytes.len() && bytes[at].is_ascii_digit() {
            at += 1;
        }
        let mut decimals = false;
        if at + 1 < bytes.len() && bytes[at] == b'.' && bytes[at + 1].is_ascii_digit() {
            decimals = true;
            at += 1;
            while at < bytes.len() && bytes[at].is_ascii_digit() {
                at += 1;
            }
        }
        let sign = start.checked_sub(1).map(|before| bytes[before]);
        let value: f64 = text[start..at].parse().unwrap_or(f64::INFINITY);
        found.push(Number {
            value: if sign == Some(b'-') { -value } else { value },
            plus: sign == Some(b'+'),
            decimals,
            degrees: text[at..].trim_start().to_lowercase().starts_with("deg"),
        });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &[&str]) -> Option<Vec<f64>> {
        tilts_of_names(&names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn tilts_are_told_from_counters_and_magnifications() {
        assert_eq!(of(&["foil_001_-4.0_20kx.tif", "foil_002_0.0_20kx.tif"]), Some(vec![-4.0, 0.0]));
        assert_eq!(of(&["rendered_-4deg.png", "rendered_+4deg.png"]), Some(vec![-4.0, 4.0]));
        assert_eq!(of(&["tial_a-2.08.png", "tial_a+2.08.png"]), Some(vec![-2.08, 2.08]));
        assert_eq!(of(&["x_-10.tif", "x_0.tif", "x_10.tif"]), Some(vec![-10.0, 0.0, 10.0]));
        assert_eq!(of(&["view-000.tif", "view-001.tif", "view-002.tif"]), None);
        assert_eq!(of(&["1.tif", "2.tif"]), None);
        assert_eq!(of(&["a.tif", "b.tif"]), None);
        assert_eq!(of(&["t_120.5.tif", "t_122.5.tif"]), None);
    }

    #[test]
    fn tables_have_a_row_a_view() {
        let path = Path::new("tilts.csv");
        let table = parse_table("file,tilt_deg\na.tif,-2\n\"b.tif\", 2.5 # later\n", path).unwrap();
        assert_eq!((table["a.tif"], table["b.tif"]), (-2.0, 2.5));
        assert_eq!(parse_table("b.tif;4\n", path).unwrap()["b.tif"], 4.0);
        assert_eq!(parse_table("angle,exposure,image\n3,1.0,c.tif\n", path).unwrap()["c.tif"], 3.0);
        for (text, word) in
            [("a.tif\n", "FILE,TILT"), ("a,1\na,2\n", "twice"), ("a,x\nb,200\n", "no tilt"), ("", "no row")]
        {
            let message = parse_table(text, path).unwrap_err().to_string();
            assert!(message.contains(word) && message.contains("tilts.csv"), "{message}");
        }
    }
}
