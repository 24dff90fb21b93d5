//! Scores of results for all pairs of a data set.

use rayon::prelude::*;

use super::{Dataset, DatasetError, Item};
use crate::score::{PairScore, ResultCurves, ScoreError, ScoreSettings, score_pair};

/// Why a set could not be scored.
#[derive(Debug, thiserror::Error)]
pub enum SetScoreError {
    /// The data.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A result, or its comparison.
    #[error("item {item}: {source}")]
    Score {
        /// The item.
        item: String,
        /// What is wrong.
        source: ScoreError,
    },
}

/// Scores of a set.
#[derive(Clone, Debug, PartialEq)]
pub struct SetScores {
    /// One for each pair, in the order of the items.
    pub pairs: Vec<PairScore>,
    /// Items whose truth has no line that is visible in both views: nothing can be asked for there.
    pub nothing_visible: Vec<String>,
}

impl Dataset {
    /// Scores what `result` gives for each item. Every item counts: a pair that could not be reconstructed is given as
    /// [`ResultCurves::none`].
    ///
    /// # Errors
    /// Where a file is damaged, a result cannot be read, or does not belong to its item.
    pub fn score(
        &self,
        result: impl Fn(&Item) -> Result<ResultCurves, ScoreError> + Sync,
        settings: &ScoreSettings,
    ) -> Result<SetScores, SetScoreError> {
        let scored: Vec<(&Item, Option<PairScore>)> = self
            .manifest
            .items
            .par_iter()
            .with_max_len(1)
            .map(|item| {
                self.check_item(item)?;
                let truth = self.truth(item)?;
                let pair = truth.pair(item.pair[0], item.pair[1]).map_err(DatasetError::from)?;
                let at = |source| SetScoreError::Score { item: item.name.clone(), source };
                let result = result(item).map_err(at)?;
                match score_pair(&item.name, &result, &pair, settings) {
                    Ok(mut score) => {
                        score.kind.clone_from(&item.settings);
                        Ok((item, Some(score)))
                    }
                    Err(ScoreError::NothingToFind { .. }) => Ok((item, None)),
                    Err(source) => Err(at(source)),
                }
            })
            .collect::<Result<_, SetScoreError>>()?;
        let unseen = scored.iter().filter(|(_, score)| score.is_none()).map(|(item, _)| item.name.clone());
        Ok(SetScores {
            nothing_visible: unseen.collect(),
            pairs: scored.into_iter().filter_map(|(_, score)| score).collect(),
        })
    }
}
