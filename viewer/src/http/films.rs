//! Routes of paths and films.

use super::error::ApiError;
use super::query::Query;
use super::routes::json_answer;
use crate::hub::conversion::convert;
use crate::hub::films::{FilmFile, FilmOrder};
use crate::hub::{Hub, Refusal};
use axum::body::{Body, Bytes};
use axum::extract::{Path, State};
use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde_json::json;
use std::fs::File;
use std::io::Read;
use std::sync::Arc;
use tokio::task::spawn_blocking;

/// A film is sent in pieces of this size.
const CHUNK_BYTES: usize = 256 << 10;

fn refused((code, text): Refusal) -> ApiError {
    let status = match code {
        "read-only" => StatusCode::FORBIDDEN,
        "not-found" => StatusCode::NOT_FOUND,
        "too-large" => StatusCode::PAYLOAD_TOO_LARGE,
        "busy" => StatusCode::TOO_MANY_REQUESTS,
        "no-room" => StatusCode::INSUFFICIENT_STORAGE,
        "failed" => StatusCode::INTERNAL_SERVER_ERROR,
        _ => StatusCode::BAD_REQUEST,
    };
    ApiError::new(status, code, text)
}

/// `POST /api/path`.
pub(crate) async fn path(State(hub): State<Arc<Hub>>, uri: Uri, body: Bytes) -> Result<Response, ApiError> {
    let name = Query::of(&uri).text("name").unwrap_or_default().to_owned();
    let converted = convert(&hub, &name, &body).await.map_err(refused)?;
    Ok(([(header::CONTENT_TYPE, "application/json")], converted).into_response())
}

/// `GET /api/films`.
pub(crate) async fn list(State(hub): State<Arc<Hub>>) -> Response {
    let text = hub.films.changed.borrow().to_string();
    ([(header::CONTENT_TYPE, "application/json")], text).into_response()
}

/// `POST /api/films`.
pub(crate) async fn order(State(hub): State<Arc<Hub>>, body: Bytes) -> Result<Response, ApiError> {
    hub.check_writable().map_err(refused)?;
    let order = FilmOrder::read(&body).map_err(refused)?;
    let id = hub.films.order(&hub, &order).map_err(refused)?;
    Ok((StatusCode::ACCEPTED, json_answer(&json!({"id": id}))).into_response())
}

fn id_of(text: &str) -> Result<u32, ApiError> {
    let id = text.trim_end_matches(".mp4").parse();
    id.map_err(|_not| refused(("not-found", format!("there is no film {text:?}"))))
}

/// `DELETE /api/films/ID`.
pub(crate) async fn remove(State(hub): State<Arc<Hub>>, Path(id): Path<String>) -> Result<Response, ApiError> {
    hub.check_writable().map_err(refused)?;
    hub.films.remove(id_of(&id)?).map_err(refused)?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// `GET /api/films/ID.mp4`.
pub(crate) async fn download(State(hub): State<Arc<Hub>>, Path(id): Path<String>) -> Result<Response, ApiError> {
    let FilmFile { file, bytes, name } = hub.films.open(id_of(&id)?).map_err(refused)?;
    let mut response = Body::from_stream(futures_util::stream::unfold(Some(file), next_chunk)).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("video/mp4"));
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(bytes));
    if let Ok(value) = HeaderValue::from_str(&format!("attachment; filename=\"{name}\"")) {
        headers.insert(header::CONTENT_DISPOSITION, value);
    }
    Ok(response)
}

/// The next piece of a file, and the file; nothing at its end.
async fn next_chunk(file: Option<File>) -> Option<(std::io::Result<Bytes>, Option<File>)> {
    let mut file = file?;
    let read = move || {
        let mut chunk = vec![0; CHUNK_BYTES];
        let count = file.read(&mut chunk)?;
        chunk.truncate(count);
        Ok((Bytes::from(chunk), file))
    };
    match spawn_blocking(read).await.ok()? {
        Ok((chunk, _)) if chunk.is_empty() => None,
        Ok((chunk, file)) => Some((Ok(chunk), Some(file))),
        Err(error) => Some((Err(error), None)),
    }
}
