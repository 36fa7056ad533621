//! What `terravision bench … --json` has found.

use serde_json::Value;

/// The measurements of a bench, by name.
#[derive(Debug)]
pub struct Findings(Value);

impl Findings {
    /// Of what a bench printed.
    ///
    /// # Panics
    /// When it is not JSON.
    #[must_use]
    pub fn of(stdout: &[u8]) -> Self {
        Self(serde_json::from_slice(stdout).unwrap_or_else(|error| panic!("{error}: not the findings of a bench")))
    }

    /// A measurement, if it was made.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f64> {
        let all = self.0["measurements"].as_array()?;
        all.iter().find(|measurement| measurement["name"] == name)?["value"].as_f64()
    }

    /// A measurement.
    ///
    /// # Panics
    /// When it was not made.
    #[must_use]
    pub fn value(&self, name: &str) -> f64 {
        self.get(name).unwrap_or_else(|| panic!("{name} is missing: {}", self.0))
    }
}
