//! The routes below `/api`.

use super::error::ApiError;
use super::query::Query;
use crate::hub::{Hub, MESSAGE_BYTES, MOST_HEIGHTS};
use crate::picture::HEADER_BYTES;
use crate::socket::{self, is_token};
use crate::stills::StillError;
use axum::body::Bytes;
use axum::extract::{FromRequestParts, Request, State, WebSocketUpgrade};
use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use terravision_common::viewer::{SIDES_PX, ViewerPose};

/// Most bytes of a WebSocket that wait to be sent.
const MOST_WRITE_BYTES: usize = 64 << 20;

pub(crate) fn json_answer(value: &Value) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], value.to_string()).into_response()
}

/// `GET /api/info`.
pub(crate) async fn info(State(hub): State<Arc<Hub>>) -> Response {
    let mut info = hub.info();
    let flight = hub.flight.borrow().clone();
    info["settings"] = json!(flight.settings);
    info["size"] = json!(hub.size());
    json_answer(&info)
}

/// `GET /api/still.png`.
pub(crate) async fn still(State(hub): State<Arc<Hub>>, uri: Uri) -> Result<Response, ApiError> {
    let query = Query::of(&uri);
    let pose = ViewerPose {
        x: query.needed("x")?,
        y: query.needed("y")?,
        z: query.needed("z")?,
        heading: query.needed("heading")?,
        pitch: query.needed("pitch")?,
        roll: query.number("roll")?.unwrap_or(0.0),
        vfov: query.number("vfov")?.unwrap_or(60.0),
    };
    let bad = |code, text| ApiError::new(StatusCode::BAD_REQUEST, code, text);
    if let Some(fault) = pose.fault() {
        return Err(bad("bad-pose", fault));
    }
    let sides = [query.number::<u32>("width")?, query.number::<u32>("height")?];
    let [low, high] = SIDES_PX;
    if let Some(side) = sides.into_iter().flatten().find(|side| !(1..=high).contains(side)) {
        return Err(bad("bad-size", format!("width, height: expected numbers from 1 to {high}, found {side}")));
    }
    let [usual_width, usual_height] = hub.size().map(|side| side.max(low));
    let size = [sides[0].unwrap_or(usual_width), sides[1].unwrap_or(usual_height)];
    let has_stereo = query.number::<u8>("stereo")?.is_some_and(|stereo| stereo != 0);
    let mut order = hub.still_order(pose, Some(size), has_stereo);
    if query.number::<u8>("light")? == Some(0) {
        order.settings = order.settings.unlit();
    }
    let file = hub.stills.draw(&order).await.map_err(|error| match error {
        StillError::Busy => ApiError::new(StatusCode::TOO_MANY_REQUESTS, "busy", error.to_string()),
        StillError::Failed(_) => ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, "failed", error.to_string()),
    })?;
    let mut response = ([(header::CONTENT_TYPE, "image/png")], file).into_response();
    // A command with characters that a header cannot hold is left out.
    if let Ok(command) = HeaderValue::from_str(&hub.stills.command(&order)) {
        response.headers_mut().insert("x-terravision-command", command);
    }
    Ok(response)
}

/// `POST /api/heights`.
pub(crate) async fn heights(State(hub): State<Arc<Hub>>, body: Bytes) -> Result<Response, ApiError> {
    let places: Vec<[f64; 2]> = serde_json::from_slice(&body)
        .map_err(|error| ApiError::bad_request(format!("expected a JSON array of [x, y]: {error}")))?;
    if places.len() > MOST_HEIGHTS {
        let text = format!("expected at most {MOST_HEIGHTS} places, found {}", places.len());
        return Err(ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, "too-large", text));
    }
    let failed = |error: &dyn std::fmt::Display| {
        ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, "failed", format!("heights cannot be read: {error}"))
    };
    let _turn = hub.reading.acquire().await.map_err(|error| failed(&error))?;
    let asked = Arc::clone(&hub);
    let heights = tokio::task::spawn_blocking(move || asked.terrain.heights(&places)).await;
    Ok(json_answer(&json!(heights.map_err(|error| failed(&error))?)))
}

/// `GET /api/metrics`.
pub(crate) async fn metrics(State(hub): State<Arc<Hub>>) -> Response {
    let of = |counter: &std::sync::atomic::AtomicU64| counter.load(Ordering::Relaxed) as f64;
    let tally = &hub.tally;
    let clients = hub.clients() as f64;
    let own = [
        ("clients", "gauge", "Browsers and programs that are connected.", Some(clients)),
        ("frames_total", "counter", "Frames taken from the flight.", Some(of(&tally.frames))),
        ("pictures_total", "counter", "Pictures sent to clients.", Some(of(&tally.pictures))),
        ("picture_bytes_total", "counter", "Bytes of pictures sent to clients.", Some(of(&tally.bytes))),
        ("poses_total", "counter", "Poses accepted from pilots.", Some(of(&tally.poses))),
        ("stills_total", "counter", "Stills drawn, or begun.", Some(hub.stills.drawn() as f64)),
        ("refused_total", "counter", "Messages and requests refused.", Some(of(&tally.refused))),
        ("encode_seconds", "gauge", "Median time to encode a picture.", hub.encoder.median_ms().map(|ms| ms / 1e3)),
        (
            "latency_seconds",
            "gauge",
            "Median time from pose to encoded picture.",
            tally.latency_ms().map(|ms| ms / 1e3),
        ),
    ];
    let mut text = String::new();
    for (name, kind, help, value) in own {
        if let Some(value) = value {
            let name = format!("terravision_viewer_{name}");
            text += &format!("# HELP {name} {help}\n# TYPE {name} {kind}\n{name} {value}\n");
        }
    }
    text += &hub.metrics_of_flight().await.unwrap_or_default();
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response()
}

/// `GET /api/socket`.
pub(crate) async fn websocket(State(hub): State<Arc<Hub>>, request: Request) -> Response {
    let token = super::guard::token(&request);
    let is_known = hub.setup().token.is_none() || is_token(&hub, token.as_deref());
    let (mut parts, _body) = request.into_parts();
    let upgrade = match WebSocketUpgrade::from_request_parts(&mut parts, &()).await {
        Ok(upgrade) => upgrade,
        Err(rejection) => return ApiError::bad_request(rejection.body_text()).into_response(),
    };
    let upgrade = upgrade.max_message_size(MESSAGE_BYTES).max_frame_size(MESSAGE_BYTES);
    // A picture is behind its header at once, and never behind another picture.
    let upgrade = upgrade.write_buffer_size(HEADER_BYTES).max_write_buffer_size(MOST_WRITE_BYTES);
    upgrade.on_upgrade(move |socket| socket::run(socket, hub, is_known))
}

/// What is not there.
pub(crate) async fn nothing(uri: Uri) -> ApiError {
    ApiError::new(StatusCode::NOT_FOUND, "not-found", format!("there is nothing at {}", uri.path()))
}

/// What is there, but not by this method.
pub(crate) async fn wrong_method(uri: Uri) -> ApiError {
    let text = format!("{} is not to be asked for by this method", uri.path());
    ApiError::new(StatusCode::METHOD_NOT_ALLOWED, "wrong-method", text)
}
