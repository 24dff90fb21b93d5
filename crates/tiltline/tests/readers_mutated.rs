//! Valid files with damaged bytes: the readers fail or give an image, and never panic or ask for absurd memory.
//!
//! The bodies are those of the fuzz targets in `fuzz/`, which go deeper where cargo-fuzz is installed.
// clippy.toml allows this in `#[test]` functions, not in what they call.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use proptest::prelude::*;
use proptest::sample::{Index, select};
use tiltline::io::exercise;

/// One change to a file.
#[derive(Clone, Debug)]
enum Damage {
    /// A byte gets any value.
    Byte(Index, u8),
    /// Two or four bytes get an extreme or ordinary number, in either order: sizes, offsets and counts live there.
    Number(Index, u32, bool, bool),
    /// The end is missing.
    Cut(Index),
    /// Bytes are copied from one place over another.
    Copy(Index, Index, u8),
    /// Bytes are put in between.
    Insert(Index, Vec<u8>),
}

fn damage() -> impl Strategy<Value = Damage> {
    let numbers =
        select(vec![0, 1, 2, 3, 5, 6, 8, 16, 0x7f, 0x80, 0xff, 0x7fff, 0x8000, 0xffff, 1 << 20, i32::MAX as u32])
            .prop_union(select(vec![1 << 31, u32::MAX - 1, u32::MAX]));
    prop_oneof![
        3 => (any::<Index>(), any::<u8>()).prop_map(|(at, byte)| Damage::Byte(at, byte)),
        6 => (any::<Index>(), numbers, any::<bool>(), any::<bool>())
            .prop_map(|(at, value, is_short, is_big)| Damage::Number(at, value, is_short, is_big)),
        1 => any::<Index>().prop_map(Damage::Cut),
        1 => (any::<Index>(), any::<Index>(), any::<u8>()).prop_map(|(from, to, count)| Damage::Copy(from, to, count)),
        1 => (any::<Index>(), prop::collection::vec(any::<u8>(), 1..16)).prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
    ]
}

/// Applies one change; of an empty file nothing is left to change.
fn apply(bytes: &mut Vec<u8>, damage: &Damage) {
    if bytes.is_empty() {
        return;
    }
    match damage {
        Damage::Byte(at, byte) => {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        Damage::Number(at, value, is_short, is_big) => {
            let at = at.index(bytes.len()) & !1;
            let number: Vec<u8> = match (is_short, is_big) {
                (false, false) => value.to_le_bytes().to_vec(),
                (false, true) => value.to_be_bytes().to_vec(),
                (true, false) => (*value as u16).to_le_bytes().to_vec(),
                (true, true) => (*value as u16).to_be_bytes().to_vec(),
            };
            bytes.iter_mut().skip(at).zip(number).for_each(|(old, new)| *old = new);
        }
        Damage::Cut(at) => bytes.truncate(at.index(bytes.len())),
        Damage::Copy(from, to, count) => {
            let (from, to) = (from.index(bytes.len()), to.index(bytes.len()));
            let count = usize::from(*count).min(bytes.len() - from.max(to));
            bytes.copy_within(from..from + count, to);
        }
        Damage::Insert(at, new) => {
            let at = at.index(bytes.len());
            bytes.splice(at..at, new.iter().copied());
        }
    }
}

/// The valid files whose names end so.
fn files(endings: &[&str]) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut paths: Vec<_> = entries
        .filter(|path| endings.iter().any(|ending| path.extension().is_some_and(|own| own == *ending)))
        .collect();
    paths.sort();
    assert!(paths.len() > 2, "the folder of test files is complete");
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

fn damaged(files: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    (select(files), prop::collection::vec(damage(), 0..6)).prop_map(|(mut bytes, damages)| {
        damages.iter().for_each(|damage| apply(&mut bytes, damage));
        bytes
    })
}

/// Gives the chunks of a PNG their right check sums again, or damage would go no further than those.
fn with_check_sums(mut bytes: Vec<u8>) -> Vec<u8> {
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4).map(|raw| u32::from_be_bytes(raw.try_into().unwrap()) as usize) {
        let end = at.saturating_add(8).saturating_add(length);
        if end.saturating_add(4) > bytes.len() {
            break;
        }
        let step = |sum: u32, _: u32| if sum & 1 == 1 { sum >> 1 ^ 0xedb8_8320 } else { sum >> 1 };
        let sum = !bytes[at + 4..end].iter().fold(!0, |sum, &byte| (0..8).fold(sum ^ u32::from(byte), step));
        bytes[end..end + 4].copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
    bytes
}

/// Text of what tilts and `.mdoc` files are made of, and of what they are not.
fn text() -> impl Strategy<Value = String> {
    let words = [
        "[ZValue = 0]",
        "[ZValue = 1]",
        "[FrameSet = 18446744073709551615]",
        "TiltAngle = ",
        "PixelSpacing = ",
        "=",
        "[",
        "]",
        "-4",
        "4.5",
        ",",
        ":",
        "0",
        "1e308",
        "-1e-308",
        "nan",
        "inf",
        "#",
        " ",
        "\n",
        "\r\n",
        "\u{fffd}",
        "\u{b5}",
    ];
    prop::collection::vec(select(words.to_vec()), 0..24).prop_map(|words| words.concat())
}

/// 1000 cases a test, a second each; PROPTEST_CASES=100000 for a night.
fn config() -> ProptestConfig {
    let default = ProptestConfig::default();
    let cases = if std::env::var_os("PROPTEST_CASES").is_some() { default.cases } else { 1000 };
    // No file of failures: those found become tests of their own.
    ProptestConfig { cases, failure_persistence: None, ..default }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn png_bytes_never_panic(bytes in damaged(files(&["png"]))) {
        exercise::png(&bytes);
        exercise::png(&with_check_sums(bytes));
    }

    #[test]
    fn tiff_bytes_never_panic(bytes in damaged(files(&["tif"]))) {
        exercise::tiff(&bytes);
    }

    #[test]
    fn mrc_bytes_never_panic(bytes in damaged(files(&["mrc", "st"]))) {
        exercise::mrc(&bytes);
    }

    #[test]
    fn any_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..1200)) {
        exercise::png(&bytes);
        exercise::tiff(&bytes);
        exercise::mrc(&bytes);
    }

    #[test]
    fn texts_never_panic(text in text()) {
        exercise::tilts(text.as_bytes());
        exercise::mdoc(text.as_bytes());
    }
}
