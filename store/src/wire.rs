//! A layer around the HTTP client: counts requests and bytes, and converts an answer with an error
//! status into an error that keeps the server's message and `Retry-After` (which `object_store`
//! does not pass on).

use crate::error::Cause;
use crate::redirect::{ConnectOptions, Following};
use crate::wire_error::WireError;
use async_trait::async_trait;
use chrono::{DateTime, Utc};
use futures_util::StreamExt;
use http::header::{CONTENT_TYPE, RANGE, RETRY_AFTER};
use http::{HeaderMap, Method, StatusCode};
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody, HttpService,
    ReqwestConnector,
};
use object_store::{ClientConfigKey, ClientOptions};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// The longest `Retry-After` that is obeyed.
pub(crate) const LONGEST_HOLD: Duration = Duration::from_secs(600);
/// At most this much of an error's text is read.
pub(crate) const ERROR_BYTES: usize = 4096;
/// Longer credentials are refused.
pub(crate) const MOST_CREDENTIAL_BYTES: usize = 64 << 10;
/// Paths at which cloud instances and containers get their credentials.
const CREDENTIAL_PATHS: [&str; 3] = ["/latest/api/token", "/latest/meta-data/", "/v2/credentials"];

/// Counts, and the server's `Retry-After`.
#[derive(Debug, Default)]
pub(crate) struct Wire {
    requests: AtomicU64,
    bytes: AtomicU64,
    hold: Mutex<Option<Instant>>,
}

impl Wire {
    pub(crate) fn count_bytes(&self, bytes: usize) {
        // Relaxed, here and below: only statistics.
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(crate) fn count_request(&self) {
        self.requests.fetch_add(1, Ordering::Relaxed);
    }

    /// Requests so far.
    pub(crate) fn requests(&self) -> u64 {
        self.requests.load(Ordering::Relaxed)
    }

    /// Bytes of content received so far.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Until when no request may be sent, by `Retry-After`.
    pub(crate) fn held_until(&self) -> Option<Instant> {
        let mut hold = self.hold.lock().unwrap_or_else(PoisonError::into_inner);
        *hold = hold.filter(|until| *until > Instant::now());
        *hold
    }

    fn hold(&self, wait: Duration) {
        let until = Instant::now() + wait.min(LONGEST_HOLD);
        let mut hold = self.hold.lock().unwrap_or_else(PoisonError::into_inner);
        *hold = Some(hold.map_or(until, |held| held.max(until)));
    }
}

/// Creates clients that count requests and bytes.
#[derive(Debug)]
pub(crate) struct Connector {
    wire: Arc<Wire>,
    options: ConnectOptions,
}

impl Connector {
    pub(crate) fn new(wire: Arc<Wire>, options: ConnectOptions) -> Self {
        Self { wire, options }
    }
}

impl HttpConnector for Connector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        // `object_store` sets a short timeout of its own for the endpoints that provide
        // credentials.
        let own = ClientOptions::new().with_connect_timeout(self.options.connect_timeout);
        let timeout = |options: &ClientOptions| options.get_config_value(&ClientConfigKey::ConnectTimeout);
        let inner = if timeout(options) == timeout(&own) {
            let client = Following::new(&self.options);
            Inner::Files(
                client.map_err(|source| object_store::Error::Generic { store: "HTTP", source: source.into() })?,
            )
        } else {
            Inner::Credentials(ReqwestConnector::default().connect(options)?)
        };
        Ok(HttpClient::new(Counted { inner, wire: Arc::clone(&self.wire) }))
    }
}

#[derive(Debug)]
enum Inner {
    Files(Following),
    Credentials(HttpClient),
}

#[derive(Debug)]
struct Counted {
    inner: Inner,
    wire: Arc<Wire>,
}

#[async_trait]
impl HttpService for Counted {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        self.wire.requests.fetch_add(1, Ordering::Relaxed);
        let is_for_range = request.headers().contains_key(RANGE);
        let is_for_credentials = CREDENTIAL_PATHS.iter().any(|path| request.uri().path().starts_with(path));
        let is_object = matches!(*request.method(), Method::GET | Method::HEAD) && !is_for_credentials;
        let answer = match &self.inner {
            Inner::Files(client) => client.execute(request).await,
            Inner::Credentials(client) => client.execute(request).await,
        };
        if is_for_credentials && !answer.as_ref().is_ok_and(|answer| answer.status().is_success()) {
            return Err(no_credentials());
        }
        let answer = answer?;
        if !is_object && answer.status().is_success() {
            // `object_store` reads all of it, without a bound.
            let (parts, body) = answer.into_parts();
            let content = start_of(body, MOST_CREDENTIAL_BYTES + 1).await;
            if content.len() > MOST_CREDENTIAL_BYTES {
                return Err(no_credentials());
            }
            return Ok(HttpResponse::from_parts(parts, content.into()));
        }
        let status = answer.status();
        // From a log-in page or a captive portal. Some servers send all files with this type: then
        // the range is valid nevertheless.
        let is_page = status == StatusCode::OK && is_for_range && is_html(answer.headers());
        if status.is_success() && !is_page {
            return Ok(answer);
        }
        let hold = retry_after(answer.headers(), Utc::now());
        let is_throttled = status == StatusCode::TOO_MANY_REQUESTS || hold.is_some();
        if let Some(hold) = hold.filter(|_| is_throttled) {
            self.wire.hold(hold);
        }
        // S3 sends details in XML, for example about an expired token.
        let text = start_of(answer.into_body(), ERROR_BYTES).await;
        let code = error_code(&String::from_utf8_lossy(&text)).unwrap_or_default();
        let cause = match status.as_u16() {
            200 => Cause::WebPage,
            404 | 410 => Cause::NotFound,
            401 | 403 | 407 => Cause::Denied,
            400 if code.contains("Token") || code.contains("Credential") => Cause::Denied,
            429 => Cause::Throttled,
            503 if is_throttled => Cause::Throttled,
            408 | 425 | 500.. => Cause::Server,
            300..=399 => Cause::Redirects,
            _ => Cause::Refused,
        };
        let code = if code.is_empty() { code } else { format!(", {code}") };
        let why = match cause {
            Cause::WebPage => "the server sent a web page in place of the file (a log-in?)".to_owned(),
            Cause::NotFound => format!("the server has no such file ({status}{code})"),
            Cause::Denied => format!("the server gives no access ({status}{code}): wrong or expired credentials?"),
            Cause::Throttled => format!("the server asks for fewer requests ({status}{code})"),
            Cause::Server => format!("the server failed ({status}{code})"),
            _ => format!("the server refused the request ({status}{code})"),
        };
        Err(HttpError::new(HttpErrorKind::Unknown, WireError::new(cause, why)))
    }
}

fn is_html(headers: &HeaderMap) -> bool {
    let kind = headers.get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    kind.is_some_and(|kind| kind.trim_start().to_ascii_lowercase().starts_with("text/html"))
}

/// The first bytes of an answer, as far as they arrive.
async fn start_of(body: HttpResponseBody, most: usize) -> Vec<u8> {
    let mut parts = body.bytes_stream();
    let mut start = Vec::new();
    while start.len() < most {
        match parts.next().await {
            Some(Ok(part)) => start.extend_from_slice(&part[..part.len().min(most - start.len())]),
            Some(Err(_)) | None => break,
        }
    }
    start
}

fn no_credentials() -> HttpError {
    let why = "there are no credentials: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or \
               AWS_SKIP_SIGNATURE=true for a bucket that anyone may read";
    HttpError::new(HttpErrorKind::Unknown, WireError::new(Cause::Credentials, why))
}

/// The duration of `Retry-After` (RFC 9110, section 10.2.3): seconds, or a date.
fn retry_after(headers: &HeaderMap, now: DateTime<Utc>) -> Option<Duration> {
    let text = headers.get(RETRY_AFTER)?.to_str().ok()?.trim();
    if let Ok(seconds) = text.parse::<u64>() {
        return Some(Duration::from_secs(seconds));
    }
    let date = DateTime::parse_from_rfc2822(text).ok()?.with_timezone(&Utc);
    Some((date - now).to_std().unwrap_or(Duration::ZERO))
}

/// The code in an S3 error document.
fn error_code(text: &str) -> Option<String> {
    let code = text.split_once("<Code>")?.1.split_once("</Code>")?.0;
    let is_code = code.len() <= 64 && code.chars().all(|c| c.is_ascii_alphanumeric());
    is_code.then(|| code.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use http::HeaderValue;

    #[test]
    fn retry_after_is_seconds_or_a_date() {
        let now = DateTime::parse_from_rfc2822("Wed, 21 Oct 2015 07:28:00 GMT").expect("a date").with_timezone(&Utc);
        let after = |text: &'static str| {
            retry_after(&HeaderMap::from_iter([(RETRY_AFTER, HeaderValue::from_static(text))]), now)
        };
        assert_eq!(after("7"), Some(Duration::from_secs(7)));
        assert_eq!(after("Wed, 21 Oct 2015 07:28:30 GMT"), Some(Duration::from_secs(30)));
        assert_eq!(after("Wed, 21 Oct 2015 07:27:00 GMT"), Some(Duration::ZERO));
        assert_eq!(after("soon"), None);
        assert_eq!(retry_after(&HeaderMap::new(), now), None);
    }

    #[test]
    fn codes_of_errors_are_taken_from_xml_and_nothing_else() {
        assert_eq!(error_code("<Error><Code>ExpiredToken</Code></Error>").as_deref(), Some("ExpiredToken"));
        assert_eq!(error_code("<Code><script></Code>"), None);
        assert_eq!(error_code("<html>"), None);
    }
}
