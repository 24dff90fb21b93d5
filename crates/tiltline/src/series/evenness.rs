//! What is odd about a list of tilts: order, duplicates, gaps, a reset.

/// Tilts closer than this are one, degrees.
pub(super) const SAME_TILT_DEG: f64 = 0.01;
/// A gap is a step of so many usual ones.
const GAP_STEPS: f64 = 1.6;
/// So many views at one tilt are no repeated exposure: the list was reset.
const RESET_VIEWS: usize = 4;

/// The usual step between neighbours of sorted, distinct tilts: the median; 0 for fewer than two.
pub(super) fn usual_step_deg(sorted: &[f64]) -> f64 {
    let mut steps: Vec<f64> = sorted.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(0.0)
}

/// Sentences about tilts that are out of order, duplicate, missing or reset; `tilts_deg` in the order of the sections.
///
/// ```
/// let notes = tiltline::series::tilt_notes(&[0.0, 2.0, 4.0, 8.0, 10.0, 12.0]);
/// assert!(notes[0].contains("between 4 and 8"));
/// ```
pub fn tilt_notes(tilts_deg: &[f64]) -> Vec<String> {
    let mut notes = Vec::new();
    let rises = tilts_deg.windows(2).filter(|pair| pair[1] > pair[0]).count();
    let falls = tilts_deg.windows(2).filter(|pair| pair[1] < pair[0]).count();
    if rises > 0 && falls > 0 {
        notes.push("the views are not in the order of their tilts: they are sorted".to_owned());
    }
    let mut order: Vec<usize> = (0..tilts_deg.len()).collect();
    order.sort_by(|&a, &b| tilts_deg[a].total_cmp(&tilts_deg[b]).then(a.cmp(&b)));
    let mut distinct: Vec<f64> = Vec::new();
    let mut start = 0;
    for end in 1..=order.len() {
        let tilt = tilts_deg[order[start]];
        if end < order.len() && tilts_deg[order[end]] - tilt < SAME_TILT_DEG {
            continue;
        }
        distinct.push(tilt);
        let same = &order[start..end];
        if same.len() >= RESET_VIEWS {
            notes.push(format!(
                "{} views (sections {}) have the tilt {tilt} degrees: the tilts were reset or not recorded there; only the \
                 first of them is used",
                same.len(),
                list(same)
            ));
        } else if same.len() > 1 {
            notes.push(format!("sections {} have one tilt, {tilt} degrees: the first of them is used", list(same)));
        }
        start = end;
    }
    let step = usual_step_deg(&distinct);
    for pair in distinct.windows(2) {
        if step > 0.0 && pair[1] - pair[0] > GAP_STEPS * step {
            notes.push(format!(
                "there is no view between {} and {} degrees, where the usual step is {step:.2}",
                pair[0], pair[1]
            ));
        }
    }
    notes
}

/// The first few numbers of a list.
fn list(sections: &[usize]) -> String {
    const SHOWN: usize = 6;
    let shown: Vec<String> = sections.iter().take(SHOWN).map(usize::to_string).collect();
    let more = if sections.len() > SHOWN { ", ..." } else { "" };
    shown.join(", ") + more
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_tilts_in_either_order_raise_no_doubt() {
        let up: Vec<f64> = (-10..=10).map(|k| 2.0 * f64::from(k)).collect();
        let down: Vec<f64> = up.iter().rev().copied().collect();
        assert!(tilt_notes(&up).is_empty() && tilt_notes(&down).is_empty());
        assert_eq!(usual_step_deg(&up), 2.0);
    }

    #[test]
    fn what_is_odd_is_named_with_its_values() {
        // Dose-symmetric order, as microscopes take series.
        assert!(tilt_notes(&[0.0, 2.0, -2.0, 4.0, -4.0])[0].contains("sorted"));
        assert!(tilt_notes(&[0.0, 2.0, 2.0, 4.0])[0].contains("sections 1, 2 have one tilt, 2"));
        let reset = tilt_notes(&[-4.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(reset[0].contains("5 views (sections 2, 3, 4, 5, 6)") && reset[0].contains("reset"), "{reset:?}");
        assert!(tilt_notes(&[0.0, 2.0, 4.0, 10.0, 12.0])[0].contains("between 4 and 10"));
    }
}
