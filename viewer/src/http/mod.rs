//! HTTP: connections, routes, and who may use them.

mod error;
mod files;
mod films;
mod guard;
mod query;
mod routes;

use crate::hub::Hub;
use crate::hub::conversion::MOST_PATH_BYTES;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::routing::{get, post};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

/// Most connections at a time; others wait to be accepted.
const MOST_CONNECTIONS: usize = 256;
/// Longest time for the head of a request.
const HEAD_WITHIN: Duration = Duration::from_secs(10);
/// Longest head of a request, bytes.
const MOST_HEAD_BYTES: usize = 16 << 10;
/// Longest body of a request, bytes.
const MOST_BODY_BYTES: usize = 256 << 10;
/// After a connection could not be accepted: there are no files left, say.
const AGAIN_AFTER: Duration = Duration::from_millis(100);

fn router(hub: &Arc<Hub>) -> Router {
    Router::new()
        .route("/api/info", get(routes::info))
        .route("/api/still.png", get(routes::still))
        .route("/api/heights", post(routes::heights))
        .route("/api/metrics", get(routes::metrics))
        .route("/api/path", post(films::path).layer(DefaultBodyLimit::max(MOST_PATH_BYTES)))
        .route("/api/films", get(films::list).post(films::order).layer(DefaultBodyLimit::max(MOST_PATH_BYTES)))
        .route("/api/films/{id}", get(films::download).delete(films::remove))
        .route(guard::SOCKET, get(routes::websocket))
        .route("/api/{*rest}", get(routes::nothing))
        .fallback(get(files::file))
        .method_not_allowed_fallback(routes::wrong_method)
        .layer(DefaultBodyLimit::max(MOST_BODY_BYTES))
        .layer(from_fn_with_state(Arc::clone(hub), guard::guard))
        .with_state(Arc::clone(hub))
}

/// Accepts connections until the hub ends.
pub(crate) async fn serve(listener: TcpListener, hub: Arc<Hub>) {
    let (router, connections) = (router(&hub), Arc::new(Semaphore::new(MOST_CONNECTIONS)));
    let mut ending = hub.ending.subscribe();
    loop {
        let Ok(place) = Arc::clone(&connections).acquire_owned().await else { return };
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = ending.wait_for(|is_ending| *is_ending) => return,
        };
        match accepted {
            Ok((stream, _)) => {
                let router = router.clone();
                tokio::spawn(async move {
                    connection(stream, router).await;
                    drop(place);
                });
            }
            Err(error) => {
                tracing::warn!(%error, "a connection cannot be accepted");
                tokio::time::sleep(AGAIN_AFTER).await;
            }
        }
    }
}

async fn connection(stream: TcpStream, router: Router) {
    // Small messages are not to wait for larger ones; where it is refused, they do.
    stream.set_nodelay(true).ok();
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN).max_buf_size(MOST_HEAD_BYTES);
    let service = TowerToHyperService::new(router);
    // A client that breaks off is not worth a message.
    builder.serve_connection(TokioIo::new(stream), service).with_upgrades().await.ok();
}
