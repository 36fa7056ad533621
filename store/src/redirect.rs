//! Follows redirects: a limited number, only to web servers, and without sending secrets to other
//! hosts.
//!
//! (The HTTP client could follow them itself, but it would send `x-amz-security-token` to other
//! hosts, and in `Referer` the URL that redirected, including its query.)

use crate::error::Cause;
use crate::wire_error::WireError;
use http::header::{ACCEPT, IF_MATCH, IF_MODIFIED_SINCE, IF_NONE_MATCH, IF_UNMODIFIED_SINCE, LOCATION, RANGE};
use http::{HeaderMap, HeaderName, Method, StatusCode, Uri};
use object_store::client::{HttpClient, HttpError, HttpErrorKind, HttpRequest, HttpRequestBody, HttpResponse};
use std::time::Duration;
use url::Url;

/// Maximum number of redirects of one request.
pub(crate) const MOST_REDIRECTS: usize = 10;
/// Headers that may be sent to another host: they say which bytes of which state are wanted. All
/// others may be secret.
const FOR_ANYBODY: [HeaderName; 6] = [ACCEPT, RANGE, IF_MATCH, IF_NONE_MATCH, IF_MODIFIED_SINCE, IF_UNMODIFIED_SINCE];

/// Options of connections.
#[derive(Debug, Clone)]
pub(crate) struct ConnectOptions {
    pub(crate) connect_timeout: Duration,
    pub(crate) idle_connections: usize,
}

/// A client that follows redirects as described above.
#[derive(Debug)]
pub(crate) struct Following {
    inner: reqwest::Client,
    client: HttpClient,
}

impl Following {
    pub(crate) fn new(options: &ConnectOptions) -> Result<Self, reqwest::Error> {
        let builder = reqwest::Client::builder()
            .user_agent(concat!("terravision/", env!("CARGO_PKG_VERSION")))
            .connect_timeout(options.connect_timeout)
            .pool_max_idle_per_host(options.idle_connections)
            .redirect(reqwest::redirect::Policy::none())
            .referer(false)
            // As in `object_store`: parallel requests are faster without HTTP/2, and lengths must
            // be those of files, not of compressed answers.
            .http1_only()
            .no_gzip()
            .no_brotli()
            .no_zstd()
            .no_deflate();
        let inner = builder.build()?;
        Ok(Self { client: HttpClient::new(inner.clone()), inner })
    }

    /// Sends a request, and repeats it at the address of each redirect.
    pub(crate) async fn execute(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let (parts, body) = request.into_parts();
        let url = Url::parse(&parts.uri.to_string()).map_err(|error| refused(Cause::Refused, error.to_string()))?;
        // User and password of a URL become a header, which is dropped before another host is
        // asked.
        let first = self.inner.request(parts.method.clone(), url).headers(parts.headers).build();
        let first = first.map_err(|error| HttpError::new(HttpErrorKind::Request, error))?;
        let (mut url, mut headers) = (first.url().clone(), first.headers().clone());
        // A request that changes something on a server is not sent twice.
        if !matches!(parts.method, Method::GET | Method::HEAD) {
            return self.client.execute(build(&parts.method, &url, &headers, body)?).await;
        }
        for _ in 0..=MOST_REDIRECTS {
            let request = build(&parts.method, &url, &headers, HttpRequestBody::empty())?;
            let answer = self.client.execute(request).await?;
            let Some(next) = next_of(&url, answer.status(), answer.headers()) else { return Ok(answer) };
            let next = next?;
            if next.origin() != url.origin() {
                headers = for_another_host(&headers);
            }
            url = next;
        }
        Err(refused(Cause::Redirects, "the server redirects without end"))
    }
}

fn refused(cause: Cause, why: impl Into<String>) -> HttpError {
    HttpError::new(HttpErrorKind::Unknown, WireError::new(cause, why))
}

fn build(method: &Method, url: &Url, headers: &HeaderMap, body: HttpRequestBody) -> Result<HttpRequest, HttpError> {
    let unusable = |error: http::Error| refused(Cause::Refused, format!("its address cannot be used ({error})"));
    let uri = Uri::try_from(url.as_str()).map_err(|error| unusable(error.into()))?;
    let mut request = HttpRequest::new(body);
    (*request.method_mut(), *request.uri_mut(), *request.headers_mut()) = (method.clone(), uri, headers.clone());
    Ok(request)
}

/// The target of a redirect; `None` if the answer is not a redirect.
fn next_of(url: &Url, status: StatusCode, headers: &HeaderMap) -> Option<Result<Url, HttpError>> {
    if !matches!(status.as_u16(), 301 | 302 | 303 | 307 | 308) {
        return None;
    }
    let next = url.join(headers.get(LOCATION)?.to_str().ok()?);
    Some(match next {
        Ok(next) if matches!(next.scheme(), "http" | "https") => {
            let mut next = next;
            // User and password in such a URL come from the server and are not ours.
            next.set_username("").unwrap_or_default();
            next.set_password(None).unwrap_or_default();
            Ok(next)
        }
        Ok(next) => {
            let why = format!("the server redirects to {}://, expected http:// or https://", next.scheme());
            Err(refused(Cause::Redirects, why))
        }
        Err(error) => Err(refused(Cause::Redirects, format!("the server redirects to no address ({error})"))),
    })
}

fn for_another_host(headers: &HeaderMap) -> HeaderMap {
    headers.iter().filter(|(name, _)| FOR_ANYBODY.contains(name)).map(|(n, v)| (n.clone(), v.clone())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use http::HeaderValue;
    use http::header::{AUTHORIZATION, COOKIE, HOST};

    #[test]
    fn secrets_do_not_go_to_another_host() {
        let names =
            ["x-amz-security-token", "x-amz-date", AUTHORIZATION.as_str(), COOKIE.as_str(), HOST.as_str(), "x-any"];
        let value = || HeaderValue::from_static("1");
        let mut headers: HeaderMap =
            names.iter().map(|name| (HeaderName::from_bytes(name.as_bytes()).unwrap(), value())).collect();
        headers.insert(RANGE, value());
        let left = for_another_host(&headers);
        assert_eq!(left.keys().collect::<Vec<_>>(), [RANGE]);
    }

    #[test]
    fn redirects_lead_to_web_servers_alone() {
        let url = Url::parse("https://h:1/a/b?token=1").unwrap();
        let to = |status: u16, location: &'static str| {
            let headers = HeaderMap::from_iter([(LOCATION, HeaderValue::from_static(location))]);
            next_of(&url, StatusCode::from_u16(status).unwrap(), &headers)
        };
        let led = |location| to(302, location).unwrap().unwrap().to_string();
        assert_eq!(led("/c"), "https://h:1/c");
        assert_eq!(led("c?d=1"), "https://h:1/a/c?d=1");
        assert_eq!(led("http://me:word@g/x"), "http://g/x");
        for bad in ["file:///etc/passwd", "ftp://h/x", "http://", "gopher://h"] {
            assert!(to(301, bad).unwrap().is_err(), "{bad}");
        }
        assert!(to(200, "/c").is_none() && to(304, "/c").is_none());
        assert!(
            next_of(&url, StatusCode::FOUND, &HeaderMap::new()).is_none(),
            "an answer without address is the answer"
        );
    }
}
