//! Partial failure, said with numbers: a stage that could do its work only in part returns warnings beside its
//! result.

use serde::{Deserialize, Serialize};

use crate::progress::Stage;

/// Something the user should know about a result, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// The stage that noticed.
    pub stage: Stage,
    /// A sentence with the numbers in it and the way out.
    pub message: String,
}

impl Warning {
    /// A warning of a stage.
    pub fn new(stage: Stage, message: impl Into<String>) -> Self {
        Self { stage, message: message.into() }
    }
}

impl std::fmt::Display for Warning {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{}: {}", self.stage, self.message)
    }
}
