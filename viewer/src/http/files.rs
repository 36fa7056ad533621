//! The page: files that are part of the program.

use axum::http::{StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

/// Name, kind and content of every file of the page.
const FILES: &[(&str, &str, &[u8])] = &[
    ("/", "text/html; charset=utf-8", include_bytes!("../../web/dist/index.html")),
    ("/page.js", "text/javascript; charset=utf-8", include_bytes!("../../web/dist/page.js")),
    ("/page.css", "text/css; charset=utf-8", include_bytes!("../../web/dist/page.css")),
    ("/icon.svg", "image/svg+xml", include_bytes!("../../web/dist/icon.svg")),
];

/// A file of the page.
pub(crate) async fn file(uri: Uri) -> Response {
    let found = FILES.iter().find(|(name, ..)| *name == uri.path());
    let Some((_, kind, content)) = found else {
        let text = format!("there is nothing at {}", uri.path());
        return super::error::ApiError::new(StatusCode::NOT_FOUND, "not-found", text).into_response();
    };
    // After an upgrade of the server the old page must not stay.
    ([(header::CONTENT_TYPE, *kind), (header::CACHE_CONTROL, "no-cache")], *content).into_response()
}
