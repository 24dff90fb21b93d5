//! The texts of tilts: the argument's forms and one number a line.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tiltline::io::exercise::tilts(bytes));
