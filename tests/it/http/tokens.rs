//! Tokens of an OpenID provider: which are accepted, whom they name, and what happens when the provider changes its keys or does not answer.

use super::harness::{Answer, Service, idle, with};
use base64::{Engine as _, engine::general_purpose::URL_SAFE_NO_PAD};
use jiff::Timestamp;
use ring::{
    hmac,
    rand::SystemRandom,
    signature::{self, EcdsaKeyPair, Ed25519KeyPair, KeyPair as _, RsaKeyPair},
};
use serde_json::{Value, json};
use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};
use ventricle::{
    access::{Access, Allowances, Expected, Fetch, Issuer, IssuerSettings},
    jobs::StoreSettings,
};

const ISSUER: &str = "https://login.example/realms/hospital";

/// Signs as one algorithm does.
enum Signer {
    Es256(EcdsaKeyPair),
    EdDsa(Ed25519KeyPair),
    Rs256(RsaKeyPair),
    Ps256(RsaKeyPair),
}

fn coded(bytes: impl AsRef<[u8]>) -> String {
    URL_SAFE_NO_PAD.encode(bytes)
}

impl Signer {
    fn es256() -> Self {
        let algorithm = &signature::ECDSA_P256_SHA256_FIXED_SIGNING;
        let random = SystemRandom::new();
        let made = EcdsaKeyPair::generate_pkcs8(algorithm, &random).unwrap();
        Self::Es256(EcdsaKeyPair::from_pkcs8(algorithm, made.as_ref(), &random).unwrap())
    }

    fn eddsa() -> Self {
        Self::EdDsa(Ed25519KeyPair::from_pkcs8(Ed25519KeyPair::generate_pkcs8(&SystemRandom::new()).unwrap().as_ref()).unwrap())
    }

    fn rsa() -> RsaKeyPair {
        // Made for these tests by `openssl genpkey`, and used nowhere else.
        RsaKeyPair::from_pkcs8(include_bytes!("tokens/rsa-of-tests.pk8")).unwrap()
    }

    fn name(&self) -> &'static str {
        match self {
            Self::Es256(_) => "ES256",
            Self::EdDsa(_) => "EdDSA",
            Self::Rs256(_) => "RS256",
            Self::Ps256(_) => "PS256",
        }
    }

    /// The public half, as providers publish it.
    fn published(&self, id: &str) -> Value {
        match self {
            Self::Es256(pair) => {
                let (x, y) = pair.public_key().as_ref()[1..].split_at(32);
                json!({ "kty": "EC", "crv": "P-256", "use": "sig", "alg": "ES256", "kid": id, "x": coded(x), "y": coded(y) })
            }
            Self::EdDsa(pair) => json!({ "kty": "OKP", "crv": "Ed25519", "kid": id, "x": coded(pair.public_key()) }),
            Self::Rs256(pair) | Self::Ps256(pair) => {
                let public = signature::RsaPublicKeyComponents::<Vec<u8>>::from(pair.public());
                json!({ "kty": "RSA", "kid": id, "n": coded(public.n), "e": coded(public.e) })
            }
        }
    }

    fn sign(&self, message: &[u8]) -> Vec<u8> {
        let random = SystemRandom::new();
        let rsa = |pair: &RsaKeyPair, padding: &'static dyn signature::RsaEncoding| {
            let mut signed = vec![0; pair.public().modulus_len()];
            pair.sign(padding, &random, message, &mut signed).unwrap();
            signed
        };
        match self {
            Self::Es256(pair) => pair.sign(&random, message).unwrap().as_ref().to_vec(),
            Self::EdDsa(pair) => pair.sign(message).as_ref().to_vec(),
            Self::Rs256(pair) => rsa(pair, &signature::RSA_PKCS1_SHA256),
            Self::Ps256(pair) => rsa(pair, &signature::RSA_PSS_SHA256),
        }
    }

    fn token(&self, id: &str, claims: &Value) -> String {
        let header = json!({ "alg": self.name(), "typ": "JWT", "kid": id });
        let message = format!("{}.{}", coded(header.to_string()), coded(claims.to_string()));
        format!("{message}.{}", coded(self.sign(message.as_bytes())))
    }
}

/// Claims that are as they should be, with some changed; `null` leaves one out.
fn claims(changed: &Value) -> Value {
    let now = Timestamp::now().as_second();
    let mut claims = json!({
        "iss": ISSUER, "aud": ["account", "ventricle"], "sub": "dr-garcia", "clinic": "ours", "scope": "openid ventricle:submit ventricle:read",
        "iat": now, "nbf": now, "exp": now + 300,
    });
    let fields = claims.as_object_mut().unwrap();
    for (name, value) in changed.as_object().unwrap() {
        if value.is_null() {
            fields.remove(name);
        } else {
            fields.insert(name.clone(), value.clone());
        }
    }
    claims
}

/// A provider in the test.
#[derive(Clone, Default)]
struct Provider {
    keys: Arc<Mutex<Vec<Value>>>,
    asked: Arc<AtomicUsize>,
    silent: Arc<AtomicBool>,
    /// How long it takes to answer.
    pauses_s: Arc<AtomicU64>,
}

impl Provider {
    fn publishing(keys: Vec<Value>) -> Self {
        let provider = Self::default();
        *provider.keys.lock().unwrap() = keys;
        provider
    }

    fn fetch(&self) -> Fetch {
        let provider = self.clone();
        Arc::new(move |url| {
            let provider = provider.clone();
            Box::pin(async move {
                provider.asked.fetch_add(1, Ordering::SeqCst);
                tokio::time::sleep(Duration::from_secs(provider.pauses_s.load(Ordering::SeqCst))).await;
                if provider.silent.load(Ordering::SeqCst) {
                    return Err("no answer".to_owned());
                }
                let document = match url.as_str() {
                    "https://login.example/realms/hospital/.well-known/openid-configuration" => {
                        json!({ "issuer": ISSUER, "jwks_uri": "https://login.example/keys", "response_types_supported": ["code"] })
                    }
                    "https://login.example/keys" => json!({ "keys": *provider.keys.lock().unwrap() }),
                    other => panic!("{other} is asked for"),
                };
                Ok(document.to_string().into_bytes())
            })
        })
    }

    async fn service(&self) -> Service {
        let expected = Expected {
            issuer: ISSUER.to_owned(),
            audience: "ventricle".to_owned(),
            owner_claim: "clinic".to_owned(),
            scope_claim: "scope".to_owned(),
            scope_prefix: "ventricle:".to_owned(),
            leeway_s: 30,
        };
        let issuer = Arc::new(Issuer::new(IssuerSettings { expected, keys_url: None }, self.fetch()));
        with(StoreSettings::default(), None, |state| state.with_access(Access::new(None, Some(issuer), Allowances::default()))).await
    }
}

async fn list(service: &Service, token: &str) -> Answer {
    service.call("GET", "/v1/reconstructions", &[("authorization", &format!("Bearer {token}"))]).await
}

#[tokio::test]
async fn tokens_of_each_kind_of_key_are_accepted_and_name_their_owner() {
    let signers = [Signer::es256(), Signer::eddsa(), Signer::Rs256(Signer::rsa()), Signer::Ps256(Signer::rsa())];
    let published = signers.iter().map(|signer| signer.published(signer.name()));
    // Of kinds that nobody here knows, and for another purpose.
    let others =
        [json!({ "kty": "AKP", "kid": "new", "pub": "x" }), json!({ "kty": "EC", "crv": "P-521", "kid": "p", "x": "AA", "y": "AA" })];
    let provider = Provider::publishing(others.into_iter().chain(published).collect());
    let service = provider.service().await;
    for signer in &signers {
        let answer = list(&service, &signer.token(signer.name(), &claims(&json!({})))).await;
        assert_eq!(answer.status, 200, "{}: {}", signer.name(), answer.json());
    }
    assert_eq!(provider.asked.load(Ordering::SeqCst), 2, "configuration and keys are asked for once");
    let token = |changed: Value| signers[0].token("ES256", &claims(&changed));
    let submitted = service
        .post(
            "",
            &[("authorization", &format!("Bearer {}", token(json!({})))), ("content-type", "application/json")],
            super::harness::study(1).to_string(),
        )
        .await;
    assert_eq!(submitted.status, 202);
    let jobs = async |token: String| list(&service, &token).await.json()["reconstructions"].as_array().unwrap().len();
    assert_eq!(jobs(token(json!({ "sub": "dr-susin" }))).await, 1, "one owner's tokens share the jobs");
    assert_eq!(jobs(token(json!({ "clinic": "theirs" }))).await, 0);
    list(&service, &token(json!({ "scope": "openid submit" }))).await.problem(403, "insufficient_scope");
    assert_eq!(list(&service, &token(json!({ "scope": ["ventricle:admin"] }))).await.status, 200);
}

#[tokio::test]
async fn tokens_that_are_not_as_they_should_be_are_refused() {
    let (signer, other) = (Signer::es256(), Signer::es256());
    let service = Provider::publishing(vec![signer.published("a"), Signer::Rs256(Signer::rsa()).published("r")]).service().await;
    let now = Timestamp::now().as_second();
    let refused = [
        (json!({ "exp": now - 31 }), "credentials_expired"),
        (json!({ "exp": null }), "credentials_invalid"),
        (json!({ "nbf": now + 60 }), "credentials_invalid"),
        (json!({ "iss": "https://login.example/realms/other" }), "credentials_invalid"),
        (json!({ "iss": null }), "credentials_invalid"),
        (json!({ "aud": "account" }), "credentials_invalid"),
        (json!({ "aud": null }), "credentials_invalid"),
        (json!({ "clinic": null }), "credentials_invalid"),
        (json!({ "clinic": "" }), "credentials_invalid"),
        (json!({ "clinic": 7 }), "credentials_invalid"),
        (json!({ "sub": null }), "credentials_invalid"),
    ];
    for (changed, code) in refused {
        list(&service, &signer.token("a", &claims(&changed))).await.problem(401, code);
    }
    assert_eq!(list(&service, &signer.token("a", &claims(&json!({ "exp": now - 10 })))).await.status, 200, "clocks may differ");
    let right = signer.token("a", &claims(&json!({})));
    let parts: Vec<&str> = right.split('.').collect();
    let header = |alg: &str| coded(json!({ "alg": alg, "kid": "a" }).to_string());
    // The public key as the secret of a signature that needs none other.
    let public = signer.published("a").to_string();
    let message = format!("{}.{}", header("HS256"), parts[1]);
    let forged = hmac::sign(&hmac::Key::new(hmac::HMAC_SHA256, public.as_bytes()), message.as_bytes());
    let wrong = [
        other.token("a", &claims(&json!({}))),
        other.token("b", &claims(&json!({}))),
        format!("{}.{}.", header("none"), parts[1]),
        format!("{}.{}.{}", header("none"), parts[1], parts[2]),
        format!("{message}.{}", coded(forged)),
        format!("{}.{}.{}", header("RS256"), parts[1], parts[2]),
        signer.token("r", &claims(&json!({}))),
        format!("{}.{}.{}", parts[0], coded(claims(&json!({ "clinic": "theirs" })).to_string()), parts[2]),
        format!("{}.{}.", parts[0], parts[1]),
        format!("{}.{}", parts[0], parts[1]),
        "x.y.z".to_owned(),
        "eyJ".to_owned(),
    ];
    // Fewer than may be refused one after the other.
    for (number, token) in wrong.iter().enumerate() {
        let answer = list(&service, token).await;
        let code = answer.json()["code"].as_str().unwrap().to_owned();
        assert!(
            (answer.status == 401 && code == "credentials_invalid") || (number > 6 && code == "too_many_attempts"),
            "{number}: {}",
            answer.json()
        );
    }
    assert_eq!(list(&service, &right).await.status, 200);
}

#[tokio::test]
async fn new_keys_of_the_provider_are_fetched_when_a_token_has_one_and_old_ones_serve_while_it_is_silent() {
    let (old, new, unknown) = (Signer::es256(), Signer::eddsa(), Signer::es256());
    let provider = Provider::publishing(vec![old.published("old")]);
    provider.silent.store(true, Ordering::SeqCst);
    let service = provider.service().await;
    let answer = list(&service, &old.token("old", &claims(&json!({})))).await;
    answer.problem(503, "issuer_unavailable");
    assert_eq!(answer.header("retry-after"), "5");
    provider.silent.store(false, Ordering::SeqCst);
    list(&service, &old.token("old", &claims(&json!({})))).await.problem(503, "issuer_unavailable");
    assert_eq!(provider.asked.load(Ordering::SeqCst), 1, "it is not asked again at once");

    let service = provider.service().await;
    assert_eq!(list(&service, &old.token("old", &claims(&json!({})))).await.status, 200);
    let asked = provider.asked.load(Ordering::SeqCst);
    provider.keys.lock().unwrap().push(new.published("new"));
    // Just asked: whoever makes up keys does not make the service ask.
    for _ in 0..5 {
        list(&service, &unknown.token("made up", &claims(&json!({})))).await.problem(401, "credentials_invalid");
    }
    assert_eq!(provider.asked.load(Ordering::SeqCst), asked);
    tokio::time::sleep(Duration::from_secs(11)).await;
    assert_eq!(list(&service, &new.token("new", &claims(&json!({})))).await.status, 200);
    assert_eq!(provider.asked.load(Ordering::SeqCst), asked + 2);
    provider.silent.store(true, Ordering::SeqCst);
    assert_eq!(list(&service, &old.token("old", &claims(&json!({})))).await.status, 200, "what is known serves on");
}

#[tokio::test]
async fn a_provider_that_takes_its_time_is_asked_once_and_waited_for_no_longer_than_a_while() {
    let signer = Signer::es256();
    let provider = Provider::publishing(vec![signer.published("one")]);
    provider.pauses_s.store(7, Ordering::SeqCst);
    let service = provider.service().await;
    let token = signer.token("one", &claims(&json!({})));
    let began = Instant::now();
    let answers = futures_util::future::join_all((0..20).map(|_| list(&service, &token))).await;
    for answer in answers {
        answer.problem(503, "issuer_unavailable");
    }
    assert!(began.elapsed() < Duration::from_secs(7), "{:?}", began.elapsed());
    assert_eq!(provider.asked.load(Ordering::SeqCst), 1);
    // What it says in the end is there for who comes then.
    provider.pauses_s.store(0, Ordering::SeqCst);
    let deadline = Instant::now() + Duration::from_secs(20);
    while list(&service, &token).await.status != 200 {
        assert!(Instant::now() < deadline);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert_eq!(provider.asked.load(Ordering::SeqCst), 2, "for its configuration and its keys");
}

#[tokio::test]
async fn without_a_provider_a_token_is_no_key() {
    let service = idle().await;
    assert_eq!(list(&service, "whatever").await.status, 200, "nobody is asked here");
}
