//! The parameters of a request.

use super::error::ApiError;
use axum::http::Uri;
use std::str::FromStr;
use url::form_urlencoded;

/// Parameters that are read of a request; more are not.
const MOST_PARAMETERS: usize = 32;

/// The parameters of a request.
#[derive(Debug)]
pub(crate) struct Query(Vec<(String, String)>);

impl Query {
    pub(crate) fn of(uri: &Uri) -> Self {
        let pairs = form_urlencoded::parse(uri.query().unwrap_or_default().as_bytes());
        Self(pairs.into_owned().take(MOST_PARAMETERS).collect())
    }

    /// The text of a parameter.
    pub(crate) fn text(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(found, _)| found == name).map(|(_, text)| text.as_str())
    }

    /// A parameter as a number.
    pub(crate) fn number<T: FromStr>(&self, name: &str) -> Result<Option<T>, ApiError> {
        let read = |text: &str| {
            text.parse().map_err(|_not| ApiError::bad_request(format!("{name}: expected a number, found {text:?}")))
        };
        self.text(name).map(read).transpose()
    }

    /// A number that has to be there.
    pub(crate) fn needed(&self, name: &str) -> Result<f64, ApiError> {
        let missing = || ApiError::bad_request(format!("{name}: expected a number, and it is missing"));
        self.number(name)?.ok_or_else(missing)
    }
}
