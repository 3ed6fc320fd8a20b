//! An Orthanc in a process of its own, run with the configuration of `deploy/orthanc`, and what is asked of it.

use crate::{
    dimse::free_port,
    served::{Answer, Directory, answer},
    shared,
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use std::{
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

const PLUGINS: &str = "/usr/share/orthanc/plugins";
/// How long anything here may take: a job of Orthanc's, its start.
const SOON: Duration = Duration::from_secs(30);
/// AE title of whoever sends images, as in the list of the configuration.
const CAMERA: &str = "CAMERA";

/// Whether Orthanc and its plugins are there.
pub(super) fn is_installed() -> bool {
    for (package, file) in
        [("orthanc", "/usr/sbin/Orthanc"), ("orthanc-dicomweb", "libOrthancDicomWeb.so"), ("orthanc-python", "libOrthancPython.so")]
    {
        if !Path::new(PLUGINS).join(file).exists() {
            shared::absent(package);
            return false;
        }
    }
    crate::dimse::has_dcmtk()
}

/// Where an Orthanc that is not started yet will be, and the password of its user.
#[derive(Clone)]
pub(super) struct Ports {
    pub(super) http: u16,
    pub(super) dicom: u16,
    password: String,
}

impl Ports {
    pub(super) fn free() -> Self {
        Self { http: free_port(), dicom: free_port(), password: uuid::Uuid::now_v7().to_string() }
    }

    /// The header by which the REST interface knows its user.
    pub(super) fn authorization(&self) -> String {
        format!("Basic {}", STANDARD.encode(format!("tester:{}", self.password)))
    }
}

/// A running Orthanc; killed when dropped. Orthanc 1.10 cannot be told to listen on the loopback interface alone (`HttpBindAddresses` came later, its DICOM
/// port has nothing of the kind): so other machines are answered 401 (`RemoteAccessAllowed`), stores are taken from listed titles at 127.0.0.1 alone
/// (`DicomAlwaysAllowStore`, `DicomCheckModalityHost`), and the REST interface has a password that is made for the test.
pub(super) struct Orthanc {
    child: Child,
    folder: Directory,
    settings: Vec<(&'static str, String)>,
    ports: Ports,
    agent: ureq::Agent,
    authorization: String,
}

impl Orthanc {
    /// Starts it as its documentation says, which forwards nothing before a series has been stable for a minute.
    pub(super) fn start(ports: Ports, ventricle: &str, scp_port: u16) -> Self {
        Self::start_with(ports, ventricle, scp_port, &[])
    }

    /// With more variables of the configuration set.
    pub(super) fn start_with(ports: Ports, ventricle: &str, scp_port: u16, variables: &[(&'static str, &str)]) -> Self {
        let folder = Directory::new("orthanc");
        let deployed = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/orthanc");
        let configuration = folder.0.join("configuration");
        let storage = folder.0.join("storage");
        std::fs::create_dir(&configuration).unwrap();
        std::fs::create_dir(&storage).unwrap();
        std::fs::copy(deployed.join("orthanc.json"), configuration.join("orthanc.json")).unwrap();
        std::fs::write(configuration.join("credentials.json"), json!({ "RegisteredUsers": { "tester": ports.password } }).to_string())
            .unwrap();
        let mut settings: Vec<(&'static str, String)> = vec![
            ("ORTHANC_STORAGE", storage.display().to_string()),
            ("ORTHANC_HTTP_PORT", ports.http.to_string()),
            ("ORTHANC_DICOM_PORT", ports.dicom.to_string()),
            ("VENTRICLE_URL", ventricle.to_owned()),
            ("VENTRICLE_SCP_PORT", scp_port.to_string()),
            ("FORWARD_SCRIPT", deployed.join("forward.py").display().to_string()),
        ];
        settings.extend(variables.iter().map(|(name, value)| (*name, (*value).to_owned())));
        let config = ureq::Agent::config_builder().http_status_as_error(false).timeout_global(Some(SOON));
        let authorization = ports.authorization();
        let child = spawn(&folder, &settings);
        let mut orthanc = Self { child, folder, settings, ports, agent: config.build().new_agent(), authorization };
        orthanc.wait();
        orthanc
    }

    /// Until it answers.
    fn wait(&mut self) {
        let start = Instant::now();
        let url = self.url("/system");
        loop {
            let answered = self.agent.get(&url).header("authorization", &self.authorization).call();
            if answered.is_ok_and(|answer| answer.status() == 200) {
                return;
            }
            let ended = self.child.try_wait().unwrap();
            assert!(ended.is_none() && start.elapsed() < SOON, "Orthanc does not start ({ended:?}):\n{}", self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Ends it in an orderly way, and starts it again on the same data.
    pub(super) fn restart(&mut self) {
        let ended = Command::new("kill").arg(self.child.id().to_string()).status().unwrap();
        assert!(ended.success(), "{ended}");
        let start = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < SOON, "Orthanc does not end:\n{}", self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
        self.child = spawn(&self.folder, &self.settings);
        self.wait();
    }

    /// What it said so far.
    pub(super) fn log(&self) -> String {
        std::fs::read_to_string(self.folder.0.join("log")).unwrap_or_default()
    }

    fn url(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.ports.http)
    }

    pub(super) fn get(&self, path: &str) -> Answer {
        answer(self.agent.get(self.url(path)).header("authorization", &self.authorization).call().unwrap())
    }

    pub(super) fn post(&self, path: &str, body: &Value) -> Answer {
        answer(self.agent.post(self.url(path)).header("authorization", &self.authorization).send(body.to_string()).unwrap())
    }

    pub(super) fn put(&self, path: &str, body: &Value) {
        let answer = answer(self.agent.put(self.url(path)).header("authorization", &self.authorization).send(body.to_string()).unwrap());
        assert_eq!(answer.status, 200, "PUT {path}: {}", String::from_utf8_lossy(&answer.body));
    }

    pub(super) fn delete(&self, path: &str) {
        let answer = answer(self.agent.delete(self.url(path)).header("authorization", &self.authorization).call().unwrap());
        assert_eq!(answer.status, 200, "DELETE {path}");
    }

    /// Sends files to it as a camera does.
    pub(super) fn receive(&self, files: &[PathBuf]) {
        let port = self.ports.dicom.to_string();
        let arguments = ["-aet", CAMERA, "-aec", "ORTHANC", "-xe", "127.0.0.1", &port];
        let output = Command::new("storescu").args(arguments).args(files).output().unwrap();
        assert!(output.status.success(), "{}\n{}", String::from_utf8_lossy(&output.stderr), self.log());
    }

    /// Orthanc's identifiers of what it has of this kind with these attributes.
    pub(super) fn find(&self, level: &str, query: &Value) -> Vec<String> {
        let found = self.post("/tools/find", &json!({ "Level": level, "Query": query })).json();
        found.as_array().unwrap().iter().map(|id| id.as_str().unwrap().to_owned()).collect()
    }

    /// Orthanc's identifier of a study by its UID.
    pub(super) fn study(&self, uid: &str) -> String {
        let [study] = self.find("Study", &json!({ "StudyInstanceUID": uid })).try_into().unwrap();
        study
    }

    /// Sends things by STOW-RS to one of its servers; the job's identifier.
    pub(super) fn forward(&self, server: &str, resources: &[&str]) -> String {
        self.start_job(&format!("/dicom-web/servers/{server}/stow"), resources)
    }

    /// Sends things by C-STORE to one of its modalities.
    pub(super) fn associate(&self, modality: &str, resources: &[&str]) -> String {
        self.start_job(&format!("/modalities/{modality}/store"), resources)
    }

    fn start_job(&self, path: &str, resources: &[&str]) -> String {
        let answer = self.post(path, &json!({ "Resources": resources, "Synchronous": false }));
        assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
        answer.json()["ID"].as_str().unwrap().to_owned()
    }

    /// Does a job that failed again.
    pub(super) fn resubmit(&self, job: &str) {
        assert_eq!(self.post(&format!("/jobs/{job}/resubmit"), &json!({})).status, 200);
    }

    /// A job once it has ended.
    pub(super) fn ended(&self, job: &str) -> Value {
        let start = Instant::now();
        loop {
            let job = self.get(&format!("/jobs/{job}")).json();
            if ["Success", "Failure"].contains(&job["State"].as_str().unwrap()) {
                return job;
            }
            assert!(start.elapsed() < SOON, "{job:#}\n{}", self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    pub(super) fn assert_succeeds(&self, job: &str) {
        let job = self.ended(job);
        assert_eq!(job["State"], "Success", "{job:#}\n{}", self.log());
    }

    /// How the jobs ended that sent something by STOW-RS, oldest first.
    pub(super) fn forwarded(&self) -> Vec<String> {
        let mut jobs = self.get("/jobs?expand").json().as_array().unwrap().clone();
        jobs.retain(|job| job["Type"] == "DicomWebStowClient");
        jobs.sort_by_key(|job| job["CreationTime"].to_string());
        jobs.iter().map(|job| job["State"].as_str().unwrap().to_owned()).collect()
    }
}

/// Starts the process; what it says goes into a file of its folder.
fn spawn(folder: &Directory, settings: &[(&'static str, String)]) -> Child {
    let log = std::fs::OpenOptions::new().create(true).append(true).open(folder.0.join("log")).unwrap();
    let mut command = Command::new("/usr/sbin/Orthanc");
    command.arg(folder.0.join("configuration")).current_dir(&folder.0).envs(settings.iter().map(|(name, value)| (name, value)));
    command.stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log).spawn().unwrap()
}

impl Drop for Orthanc {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
