//! The MRC reader: both headers and every section.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tiltline::io::exercise::mrc(bytes));
