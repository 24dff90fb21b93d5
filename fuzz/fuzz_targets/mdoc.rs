//! The .mdoc parser.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tiltline::io::exercise::mdoc(bytes));
