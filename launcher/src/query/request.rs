//! Requests: a line of JSON with many places, and the line of JSON that answers it.

use super::question::{Asker, Found, Given, MOST_RADIUS_M, Question, Refusal, Reply, Terms};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use terravision_common::ground::{Answer, Interpolation};

/// Places of a request.
pub(super) const MOST_POINTS: usize = 100_000;

/// A request, as it is sent.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Request {
    #[serde(default)]
    id: Value,
    ask: Option<Ask>,
    points: Vec<Value>,
    radius: Option<f64>,
    crs: Option<Crs>,
    agl: Option<bool>,
    interpolation: Option<How>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Ask {
    Height,
    Sight,
    Sphere,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Crs {
    World,
    Lonlat,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum How {
    Bilinear,
    Facet,
}

/// Answers a request; what it does not say is as in `terms`. A request that cannot be understood is
/// answered with a sentence. The answer ends with the line.
pub(super) fn answer(asker: &mut Asker<'_>, terms: &Terms, line: &[u8], out: &mut Vec<u8>) {
    let request = serde_json::from_slice::<Request>(line).map_err(|error| {
        format!("not a request: {error}; expected an object like {{\"ask\": \"height\", \"points\": [[x, y]]}}")
    });
    let answer = request.map(|request| {
        let id = request.id.clone();
        match answers(asker, terms, request) {
            Ok(answers) => json!({"id": id, "answers": answers}),
            Err(error) => json!({"id": id, "error": error}),
        }
    });
    let answer = answer.unwrap_or_else(|error| json!({"id": null, "error": error}));
    out.extend(answer.to_string().as_bytes());
    out.push(b'\n');
}

/// The line for a client that is refused.
pub(super) fn refusal(sentence: &str) -> Vec<u8> {
    format!("{}\n", json!({"id": null, "error": sentence})).into_bytes()
}

fn answers(asker: &mut Asker<'_>, terms: &Terms, request: Request) -> Result<Vec<Value>, String> {
    if request.points.len() > MOST_POINTS {
        return Err(format!("{} points, expected at most {MOST_POINTS} in a request", request.points.len()));
    }
    let question = match (request.ask, request.radius) {
        (None, None) => terms.question,
        (None | Some(Ask::Sphere), Some(radius)) if radius > 0.0 && radius <= MOST_RADIUS_M => Question::Sphere(radius),
        (None | Some(Ask::Sphere), Some(radius)) => {
            return Err(format!("the radius is {radius}, expected metres, more than 0 and at most {MOST_RADIUS_M}"));
        }
        (Some(Ask::Sphere), None) => match terms.question {
            Question::Sphere(radius) => Question::Sphere(radius),
            _ => return Err("a sphere has no radius: expected \"radius\": metres".to_owned()),
        },
        (Some(_), Some(_)) => return Err("only a sphere has a radius: expected \"ask\": \"sphere\"".to_owned()),
        (Some(Ask::Height), None) => Question::Height,
        (Some(Ask::Sight), None) => Question::Sight,
    };
    let terms = Terms {
        question,
        interpolation: request.interpolation.map_or(terms.interpolation, |how| match how {
            How::Bilinear => Interpolation::Bilinear,
            How::Facet => Interpolation::Facet,
        }),
        is_lonlat: request.crs.map_or(terms.is_lonlat, |crs| matches!(crs, Crs::Lonlat)),
        is_agl: request.agl.unwrap_or(terms.is_agl),
    };
    if terms.is_lonlat && !asker.knows_lonlat() {
        return Err("longitude and latitude cannot be brought into the world's CRS; ask with \"crs\": \"world\"".into());
    }
    let given = request.points.iter().map(|point| given(point, &terms)).collect();
    let mut replies = Vec::with_capacity(request.points.len());
    asker.answer_all(&terms, given, &mut replies);
    Ok(replies.iter().map(value).collect())
}

/// The numbers of a point.
fn given(point: &Value, terms: &Terms) -> Given {
    let wrong = || format!("expected [{}], finite numbers", terms.question.expected().replace(' ', ", "));
    let counts = if terms.question == Question::Height { 2..=3 } else { 6..=6 };
    let items = point.as_array().filter(|items| counts.contains(&items.len())).ok_or_else(wrong)?;
    let mut numbers = [0.0; 6];
    for (number, item) in numbers.iter_mut().zip(items) {
        *number = item.as_f64().filter(|number| number.is_finite()).ok_or_else(wrong)?;
    }
    Ok((numbers, items.len()))
}

fn value(reply: &Reply) -> Value {
    let Answer { found, is_finest } = match reply {
        Ok(answer) => answer,
        Err(Refusal::Bad(sentence)) => return json!({"status": "bad", "error": sentence}),
        Err(refusal) => return json!({"status": refusal.status()}),
    };
    let mut object = match found {
        Found::Ground { height_m, normal, above_m, is_measured } => {
            let status = if *is_measured { "ok" } else { "made-up" };
            let mut object = fields(json!({"status": status, "height": height_m, "normal": normal.to_array()}));
            above_m.map(|above_m| object.insert("above".into(), json!(above_m)));
            object
        }
        Found::Visible { distance_m } => fields(json!({"status": "visible", "distance": distance_m})),
        Found::Hidden { distance_m, at } => fields(json!({"status": "hidden", "distance": distance_m, "at": at})),
        Found::Free => fields(json!({"status": "free"})),
        Found::Touch { distance_m, center, contact, normal } => fields(json!({
            "status": "touch", "distance": distance_m, "center": center, "contact": contact, "normal": normal.to_array(),
        })),
    };
    if !is_finest {
        object.insert("coarser".into(), json!(true));
    }
    Value::Object(object)
}

fn fields(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(fields) => fields,
        _ => Map::new(),
    }
}
