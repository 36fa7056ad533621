//! Who may ask: Host, Origin and token of a request, and what browsers are told of every answer.

use super::error::ApiError;
use super::query::Query;
use crate::hub::{Hub, Tally};
use crate::socket::is_token;
use axum::extract::{Request, State};
use axum::http::header::{self, HeaderMap, HeaderName};
use axum::http::{HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::Ipv6Addr;
use std::sync::Arc;

/// The WebSocket, whose token may also come in its first message.
pub(crate) const SOCKET: &str = "/api/socket";

/// Lets a request pass, or answers why not.
pub(crate) async fn guard(State(hub): State<Arc<Hub>>, request: Request, next: Next) -> Response {
    let host = text_of(request.headers(), &header::HOST).map(str::to_owned);
    let mut response = match check(&hub, &request) {
        Ok(()) => next.run(request).await,
        Err(error) => {
            Tally::count(&hub.tally.refused, 1);
            error.into_response()
        }
    };
    protect(response.headers_mut(), host.as_deref().unwrap_or_default(), &hub.setup().embedders);
    response
}

fn text_of<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

fn check(hub: &Hub, request: &Request) -> Result<(), ApiError> {
    let headers = request.headers();
    let host = text_of(headers, &header::HOST).unwrap_or_default();
    // With a token, a page that reaches this server by a name of its own does not know it.
    if hub.setup().token.is_none() && !is_loopback(host) {
        let text = format!("Host: expected localhost, 127.0.0.1 or [::1], found {host:?}");
        return Err(ApiError::new(StatusCode::FORBIDDEN, "wrong-host", text));
    }
    let path = request.uri().path();
    let is_api = path.starts_with("/api/");
    // Browsers tell the origin where it matters; programs need not.
    let has_effect = path == SOCKET || request.method() != Method::GET;
    if let Some(origin) = headers.get(header::ORIGIN).filter(|_| has_effect) {
        let origin = origin.to_str().unwrap_or_default();
        let is_own = [format!("http://{host}"), format!("https://{host}")].iter().any(|own| own == origin);
        if !is_own && !hub.setup().embedders.iter().any(|embedder| embedder == origin) {
            let text = format!("Origin: expected that of the page of this server, found {origin:?}");
            return Err(ApiError::new(StatusCode::FORBIDDEN, "wrong-origin", text));
        }
    }
    // A page elsewhere cannot read answers, but it could have stills drawn.
    if is_api && headers.get("sec-fetch-site").is_some_and(|site| site == "cross-site") {
        let text = "Sec-Fetch-Site: expected a page of this server to ask, found another site";
        return Err(ApiError::new(StatusCode::FORBIDDEN, "wrong-origin", text));
    }
    if !is_api || hub.setup().token.is_none() || path == SOCKET {
        return Ok(());
    }
    let text = "expected the token of this server as ?token= or as Authorization: Bearer";
    match token(request) {
        None => Err(ApiError::new(StatusCode::UNAUTHORIZED, "no-token", text)),
        Some(token) if is_token(hub, Some(&token)) => Ok(()),
        Some(_) => Err(ApiError::new(StatusCode::UNAUTHORIZED, "wrong-token", text)),
    }
}

/// The token of a request, if it has one.
pub(crate) fn token(request: &Request) -> Option<String> {
    let bearer = text_of(request.headers(), &header::AUTHORIZATION).and_then(|text| text.strip_prefix("Bearer "));
    bearer.map(str::to_owned).or_else(|| Query::of(request.uri()).text("token").map(str::to_owned))
}

/// Whether a Host names this machine, and no name that somebody else may have given it.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split_once(']').map(|(name, _port)| name),
        None => Some(host.rsplit_once(':').map_or(host, |(name, _port)| name)),
    };
    let is_v6 = |name: &str| name.parse() == Ok(Ipv6Addr::LOCALHOST);
    name.is_some_and(|name| name.eq_ignore_ascii_case("localhost") || name == "127.0.0.1" || is_v6(name))
}

/// What browsers are to heed.
fn protect(headers: &mut HeaderMap, host: &str, embedders: &[String]) {
    // A Host with other characters is not repeated.
    let is_plain = host.chars().all(|c| c.is_ascii_alphanumeric() || ".-:[]".contains(c));
    // Older browsers do not count a WebSocket to the same place to 'self'.
    let sockets = if is_plain && !host.is_empty() { format!(" ws://{host} wss://{host}") } else { String::new() };
    let policy = format!(
        "default-src 'self'; img-src 'self' blob: data:; connect-src 'self'{sockets}; object-src 'none'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'self' {}",
        embedders.join(" ")
    );
    if let Ok(policy) = HeaderValue::from_str(policy.trim_end()) {
        headers.insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    let resources = HeaderName::from_static("cross-origin-resource-policy");
    headers.insert(resources, HeaderValue::from_static("same-origin"));
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_are_its_own() {
        for host in ["localhost", "LOCALHOST:8080", "127.0.0.1:1", "[::1]:8080", "[::1]"] {
            assert!(is_loopback(host), "{host}");
        }
        for host in ["", "example.org", "127.0.0.1.example.org:80", "localhost.example.org", "[::2]", "::1", "10.0.0.1"]
        {
            assert!(!is_loopback(host), "{host}");
        }
    }
}
