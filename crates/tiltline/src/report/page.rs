//! The page around the data: one HTML file (HTML Living Standard) with script and style in it and nothing to fetch.
//!
//! `page.html` is built from `web/` and committed; its Content-Security-Policy holds the hashes of its own script and
//! style. User text gets in at two places: the title, escaped as HTML, and the JSON, in which no `<` is left.

use crate::report::{FORMAT_VERSION, Report, ReportError};

/// The built page with its two placeholders.
const TEMPLATE: &str = include_str!("page.html");
/// Where the title goes.
const TITLE: &str = "{{title}}";
/// Where the JSON goes.
const DATA: &str = "{{data}}";
/// Id of the element that holds the JSON.
pub const DATA_ID: &str = "report-data";

/// The page of a report.
///
/// # Errors
/// Where the data cannot be written as JSON.
pub fn write(report: &Report) -> Result<String, ReportError> {
    // JSON needs `<` in strings only, where its escape is as good; so no text can end the element or open a comment.
    let json = serde_json::to_string(report)?.replace('<', "\\u003c");
    let [before_title, rest] = split(TEMPLATE, TITLE);
    let [before_data, after_data] = split(rest, DATA);
    let title = escaped(&title(report));
    Ok([before_title, &title, before_data, &json, after_data].concat())
}

/// The report in a page that [`write()`] made.
///
/// # Errors
/// Where there is none, or one of another version.
pub fn read(page: &str) -> Result<Report, ReportError> {
    let opening = format!("id=\"{DATA_ID}\">");
    let (_, rest) = page.split_once(&opening).ok_or(ReportError::NoData)?;
    let (json, _) = rest.split_once("</script>").ok_or(ReportError::NoData)?;
    let found = serde_json::from_str::<Version>(json)?.format_version;
    if found != FORMAT_VERSION {
        return Err(ReportError::Version { found });
    }
    Ok(serde_json::from_str(json)?)
}

#[derive(serde::Deserialize)]
struct Version {
    format_version: u32,
}

/// What the browser's tab says: the names of both files.
pub fn title(report: &Report) -> String {
    let [left, right] = report.sources.each_ref().map(|source| {
        let name = source.path.rsplit(['/', '\\']).next().unwrap_or_default();
        if name.is_empty() { "image in memory" } else { name }
    });
    format!("{left} and {right} - Tiltline")
}

fn split<'a>(text: &'a str, at: &str) -> [&'a str; 2] {
    let (before, after) =
        text.split_once(at).expect("the built page has both placeholders, which a test makes sure of");
    [before, after]
}

/// Text as it stands between tags or quotes of HTML and XML.
pub fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // XML has no such characters, not even escaped.
            letter if letter.is_control() => escaped.push('\u{fffd}'),
            letter => escaped.push(letter),
        }
    }
    escaped
}
