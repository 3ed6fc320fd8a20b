//! Extractors whose refusals are problem documents.

use super::{AppState, access::Calling, problem::Problem};
use axum::{
    extract::{FromRequestParts, Path},
    http::{StatusCode, request::Parts},
};
use serde::de::DeserializeOwned;
use uuid::Uuid;

/// The query string.
pub(super) struct Query<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Query<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let axum::extract::Query(query) = axum::extract::Query::from_request_parts(parts, state).await?;
        Ok(Self(query))
    }
}

/// An id, if the caller sees that reconstruction. No other way leads from a path to a reconstruction.
async fn seen(parts: &mut Parts, state: &AppState, id: Uuid) -> Result<Uuid, Problem> {
    Calling::from_request_parts(parts, state).await?.sees(state, id).await
}

/// The id of a reconstruction in the path, which the caller sees.
pub(super) struct Id(pub Uuid);

impl FromRequestParts<AppState> for Id {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> Result<Self, Problem> {
        let Path(id) = Path::from_request_parts(parts, state).await?;
        Ok(Self(seen(parts, state, id).await?))
    }
}

/// The id of a reconstruction and a gate, counted from 1, in the path.
pub(super) struct IdAndGate(pub Uuid, pub u32);

impl FromRequestParts<AppState> for IdAndGate {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> Result<Self, Problem> {
        let Path((id, gate)) = Path::from_request_parts(parts, state).await?;
        Ok(Self(seen(parts, state, id).await?, gate))
    }
}

/// The id of a reconstruction and the name of a picture in the path.
pub(super) struct IdAndImage(pub Uuid, pub String);

impl FromRequestParts<AppState> for IdAndImage {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &AppState) -> Result<Self, Problem> {
        let Path((id, image)) = Path::from_request_parts(parts, state).await?;
        Ok(Self(seen(parts, state, id).await?, image))
    }
}

/// A Study Instance UID in the path.
pub(super) struct StudyUid(pub String);

impl<S: Send + Sync> FromRequestParts<S> for StudyUid {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let Path(uid) = Path::<String>::from_request_parts(parts, state).await?;
        // PS3.5 §9.1.
        if !uid.is_empty() && uid.len() <= 64 && uid.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.') {
            Ok(Self(uid))
        } else {
            let detail = "The address holds no Study Instance UID: digits and dots, at most 64 characters.";
            Err(Problem::new(StatusCode::NOT_FOUND, "not_found", detail))
        }
    }
}
