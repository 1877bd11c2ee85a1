"""Each mistake is answered with one sentence, and nothing is written."""

import json

import pytest

from glucoloop.cli import main

MISTAKES = {
    "run --controller mcp": ["--controller: unknown controller 'mcp'", "did you mean 'mpc'?"],
    "run --patient operating_point=here": ["unknown operating point 'here'", "setpoint-81, nominal-22"],
    "run --patient nominal-22": ["is an operating point of parker-1999 and no patient; write 'parker-1999, operating"],
    "run --operating-point nominal-22": ["no option --operating-point; write --patient 'operating_point=...'"],
    "run --site interstitial": ["there is no option --site; write --sensor 'ideal, site=...'"],
    "run --meals 40g@8h": ["there is no option --meals; did you mean --meal?"],
    "run --target 110@22h": ["there is no option --target; did you mean --target-at?"],
    "run --max-insulin 50": ["there is no option --max-insulin; write --pump 'max_insulin_mU_min=...'"],
    "run --guard-max-hour 3": ["there is no option --guard-max-hour; write --guard 'max_hour=...'"],
    "run --meal 50q@x": ["'50q@x' is not a meal", "50g@50min"],
    "run --meal nang@50": ["is not a meal"],
    "run --meal 1e9g@50": ["1e+09 g", "at most 1000 g"],
    "run --meal 0@50": ["0 g", "more than 0"],
    "run --meal 50@-3": ["-3 min", "0 min or later"],
    "run --meal 50g@700": ["700 min", "600 min"],
    "run --meal 50g@50 --no-meal": ["there is no option --no-meal; write --meal none"],
    "run --meal 50g@50 --meal none": ["--meal none leaves all of them out; give it alone"],
    "run --meal 50@50": ["'50@50'", "write 50g@50min", "--allow-unusual"],
    "run --meal ٥٠g@50": ["is not a meal"],
    "bound --meal 50@50": ["write 50g@50min"],
    "bound --duration 5d --duration 1h": ["--duration is given twice; leave one out"],
    "run --guard --no-guard": ["there is no option --no-guard; write --guard none"],
    "run --controller pid,step_mU_min=1e-300 --allow-unusual": ["a step of 1e-300 mU/min", "give a larger step"],
    "hil --chip /dev/null": ["/dev/null is no serial port", "--chip"],
    "hil --chip /tmp": ["the serial port /tmp cannot be opened", "--chip"],
    "trial --out a --meal 50@50": ["write 50g@50min"],
    "run --setpoint 1_00": ["--setpoint is '1_00'; give a number above 0 mg/dl"],
    "run --setpoint ١٠٠": ["--setpoint is '١٠٠'; give a number"],
    "run --seed 1_0": ["--seed is '1_0'; give a whole number"],
    f"run --seed {'9' * 5000}": ["--seed is '9999", "a whole number from 0"],
    "run --controller pid,gain=1_0": ["--controller: pid: gain is '1_0'; give a finite number"],
    "run --fault missing,start_min=1_0": ["--fault: missing: start_min is '1_0'; give a finite number"],
    "trial --out a --traces ١٠": ["--traces is '١٠'; give none, all, or the number"],
    "run --controller move_weight=1e9": ["1e+09", "usually from -1e+06 to 1e+06", "--allow-unusual"],
    "run --controller move_weight=1e300": ["move_weight is 1e+300; give a number", "of a size up to 1e+30"],
    "run --controller pid,gain=1e9": ["pid: gain is 1e+09 mU/min per mg/dl", "from 0.001 to 100", "--allow-unusual"],
    "run --controller mpc-se,other_process_noise=1e150": [
        "mpc-se: other_process_noise is 1e+150; give a number of a size up to 1e+30",
    ],
    "bound --known-after 1e300": ["to 527040 min"],
    "run --duration 10x": ["--duration is '10x'; give a number above 0 min and up to 527040 min"],
    "run --duration 1000d": ["up to 527040 min"],
    "run --duration 10h --sample-time 7min": ["600 min", "7 min"],
    "run --fault missing,start_min=11h": ["660 min", "600 min"],
    "run --noise abc": ["--noise is 'abc'; give a number from 0 to 10000"],
    "run --noise nan": ["--noise is nan", "from 0 to 10000"],
    "run --noise -1": ["--noise is -1", "from 0 to 10000"],
    "run --noise 1e9": ["--noise is 1e+09", "from 0 to 10000"],
    "run --sensor white-noise,bound_mg_dl=0": ["--sensor: white-noise: bound_mg_dl is 0 mg/dl", "above 0"],
    "run --sensor lag_min=3": ["--sensor: no sensor is named; begin with its name"],
    "run --sensor=": ["--sensor is empty"],
    "run --dead-time 7": ["7 min", "5 or 10 min"],
    "run --dead-time -5": ["--dead-time is -5 min; give a number from 0 to 1440 min"],
    "run --duration 0": ["--duration is 0", "above 0"],
    "run --duration inf": ["--duration is inf", "above 0 min and up to 527040 min"],
    "run --duration 603": ["603 min", "or give --duration 605"],
    "run --sample-time 7.3": ["600 min", "7.3 min", "give --sample-time 7.5, or give --duration 598.6"],
    "bound --in-advance --sample-time 7": ["give --sample-time 7.5, or give --duration 602"],
    "trial --out a --days 2 --sample-time 7": ["2880 min", "give --sample-time 7.2."],
    "detect --out a --sample-time 7": ["1440 min", "give --sample-time 7.2"],
    "run --sample-time 0": ["--sample-time is 0 min", "from 0.1 to 120 min"],
    "run --seed -1": ["--seed is -1", "from 0 to 4294967295"],
    "run --seed 1.5": ["--seed is '1.5'", "a whole number"],
    "run --seed": ["--seed has no value; give one after it"],
    "run --controller move_horizon=0": ["--controller: move_horizon is 0; give a whole number from 1 to 50"],
    "run --controller mpc,move_horizon=0": ["--controller: mpc: move_horizon is 0; give a whole number from 1 to 50"],
    "run --controller move_horizon=9": ["prediction horizon of 8", "from 9 to"],
    "run --controller output_weight=0": ["output_weight is 0; give a finite number above 0", "above 0"],
    "run --controller move_weight=-1": ["move_weight is -1; give a finite number of 0 or more", "0 or more"],
    "run --controller constraints=lp": ["constraints is 'lp'; give clip or qp"],
    "run --controller mpc,move_weight": ["'move_weight' in 'mpc,move_weight' is no setting with a value"],
    "run --controller mpc,move_weight=1,move_weight=2": ["move_weight is given twice"],
    "run --move-weight 1": ["there is no option --move-weight; write --controller 'move_weight=...'"],
    "run --set controller.move_weigt=1": [
        "--set controller.move_weigt: the controller mpc has no setting 'move_weigt'; did"
    ],
    "run --set seed": ["--set 'seed' has no value; write it like --set patient.operating_point=fasting-81"],
    "run --set wobble=1": ["--set wobble: a run has no setting 'wobble'"],
    "bound --set controller.move_weight=1": ["--set controller.move_weight is no part of a bound; leave it out"],
    "run --integrator euler": ["--integrator is 'euler'", "give fast or adaptive"],
    "run --start 25:00": ["'25:00' is no time of day; write it like 07:30"],
    "run --pump max_insulin_mU_min=0": ["--pump: max_insulin_mU_min is 0 mU/min; give", "above 0"],
    "run --pump min_insulin_mU_min=80": ["80 to 66.9"],
    "run --pump max_change_mU_min=0": ["max_change_mU_min is 0", "above 0"],
    "run --pump resolution_mU_min=0": ["resolution_mU_min is 0", "above 0"],
    "run --setpoint 0": ["--setpoint is 0", "above 0"],
    "run --initial-glucose 500": ["500 mg/dl", "190.83"],
    "run --model laguerre_pole=1": ["--model: laguerre_pole is 1", "below 1"],
    "run --model laguerre_functions=40": ["40 Laguerre functions", "at most 36"],
    "run --model memory=1": ["--model: memory is 1", "from 2 to 2000"],
    "run --model absent.json,memory=20": ["absent.json,memory=20 cannot be read as a model: No such file"],
    "run --model memory=20 --controller pid": ["none of these controllers uses one: pid; leave it out"],
    "run --controller mpc --controller pid": ["there are 2 controllers (mpc, pid); give one, or use glucoloop compare"],
    "run --overwrite": ["--overwrite", "--out"],
    "run --out=": ["--out is empty"],
    "run --wobble": ["there is no option --wobble; see glucoloop run --help"],
    "run extra": ["extra"],
    "ruun": ["ruun", "'run'"],
    "--foo": ["there is no option --foo before a command"],
    "compare": ["1 case ", "give --controller for each of 2 or more"],
    "compare --controller mpc": ["1 case ", "give --controller for each of 2 or more"],
    "compare --controller mpc --controller mpc": ["two cases are called 'mpc'", "like label=careful"],
    "compare --controller mpc --controller mpc,noise_variance=1": [
        "the controller mpc has no setting 'noise_variance'"
    ],
    "compare --controller mpc --controller mpc,move_wait=1": ["did you mean 'move_weight'"],
    "compare --controller mpc --controller move_weight=1": ["once without a name; name the controller"],
    "compare --controller mpc --controller mpx": ["unknown controller 'mpx'"],
    "compare --controller mpc --controller mpc,label=a,move_weight=high": ["mpc: move_weight is 'high'", "a finite"],
    "compare --controller mpc --controller mpc,label=a,prediction_horizon=1": ["case 'a'", "prediction horizon of 1"],
    "compare --controller mpc --controller=": ["--controller is empty"],
    "identify --data absent.csv": ["absent.csv", "No such file"],
    "identify --amplitude 30": ["30 mU/min", "at most 25.61"],
    "identify --samples 10": ["10 samples", "72"],
    "identify --noise 1 --data record.csv": ["leave"],
    "identify --method csrs": ["--method", "--data"],
    "identify --best-pole --laguerre-pole .8": ["pole", "leave one out"],
    "identify --best-pole --laguerre-functions 0": ["no pole to search for"],
    "identify --controller mpc": ["--controller"],
}


@pytest.mark.parametrize("line", MISTAKES)
def test_mistake_is_told_in_a_sentence(refused, tmp_path, line):
    told = refused(*line.split(" "))
    for part in MISTAKES[line]:
        assert part in told
    assert list(tmp_path.iterdir()) == []


CONFIGURATIONS = {
    b"": "is empty",
    b"\x00\x01": "is not text",
    b"\xff\xfe": "is not text",
    b"a = [": "is not TOML",
    b"setpoint_mgdl = 8": "a.toml: a run has no setting 'setpoint_mgdl'; did you mean 'setpoint_mg_dl'",
    b"controller = {prediction_horzon = 8}": "a.toml: the controller mpc has no setting 'prediction_horzon'",
    b"controller = {prediction_horizon = '8'}": "a.toml: prediction_horizon is '8'; give a whole number",
    b"controller = {name = 'pid', gain = true}": "a.toml: pid: gain is True; give a finite number",
    b"controller = 'mpc, prediction_horizon=x'": "a.toml: mpc: prediction_horizon is 'x'; give a whole number",
    b"sample_time_min = 7": "give --sample-time 7.5, or give --duration 602",
    b"zzqqx = 3": "known ones is like it; --help of the command has each",
    b"pump = {insulin_upper = 3}": "the pump limited has no setting 'insulin_upper'; the known ones are: max_change",
    b"duration_min = '10x'": "a.toml: duration_min is '10x'",
    b"duration_min = '0d'": "a.toml: duration_min is 0d, which is 0 min; give",
    b"duration_min = '1h'\nfaults = ['missing, start_min=2h']": "begins at 120 min, but the run ends at 60 min",
    b"sensor = {name = 'white-noise', variance = nan}": "variance is nan (mg/dl)\u00b2; give a number from 0 to 10000",
    b"seed = 1.0": "a.toml: seed is 1; give a whole number",
    b"meals = '50@50'": "a.toml: meals is '50@50'; give a list",
    b"meals = [50]": "a.toml: meals is 50; give a text",
    b"meals = [['50g@50min']]": "give a text",
    b"controller = 3": "a.toml: 3 is no controller; give a text like 'mpc-se, move_horizon=2', or a table",
    b"controller = {name = 3}": "a.toml: 3 names no controller; begin with its name",
    b"guard = true": "a.toml: True is no guard; give a text like 'usual, max_hour=2', or a table",
    b"patient = 3": "a.toml: 3 is no patient",
    b"model = 3": "a.toml: 3 is no model",
    b"noise = 1.45": "a.toml: a run has no setting 'noise'",
    b"[[case]]": "a run has no setting 'case'",
    b"used = 3": "used is 3 in a.toml; it is the table of what was used",
}


@pytest.mark.parametrize("content", CONFIGURATIONS)
def test_configuration_file_is_refused_by_key(refused, tmp_path, content):
    (tmp_path / "a.toml").write_bytes(content)
    assert CONFIGURATIONS[content] in refused("run", "--config", "a.toml")


def test_row_of_a_record_is_counted_as_in_its_file(refused, tmp_path):
    (tmp_path / "r.csv").write_text("t_min,insulin_mU_min,glucose_mg_dl\n0,10,100\n5,10,high\n")
    assert "The glucose in row 2 of r.csv, below its first line, is 'high'" in refused("identify", "--data", "r.csv")


def test_configuration_that_is_a_folder_or_absent(refused, tmp_path):
    (tmp_path / "folder").mkdir()
    assert "is a folder" in refused("run", "--config", "folder")
    assert "No such file" in refused("run", "--config", "absent.toml")


@pytest.fixture(scope="session")
def model_text(tmp_path_factory):
    folder = tmp_path_factory.mktemp("model") / "out"
    with pytest.raises(SystemExit):
        main(["identify", "--out", str(folder)])
    return (folder / "model.json").read_text()


MODELS = {
    "version": (9, "version is 9; it should be 1"),
    "format": ("other", "format is 'other'"),
    "sample_time_min": ("5", "sample_time_min is '5'"),
    "step_response": ([0.0] * 36, "running sum"),
    "impulse_response": ([], "impulse_response"),
    "extra": (1, "extra is not a known key"),
}


@pytest.mark.long
@pytest.mark.parametrize("key", MODELS)
def test_model_that_was_changed_is_refused(refused, tmp_path, model_text, key):
    value, told = MODELS[key]
    (tmp_path / "m.json").write_text(json.dumps({**json.loads(model_text), key: value}))
    answer = refused("run", "--model", "m.json")
    assert told in answer
    assert "m.json" in answer


@pytest.mark.long
@pytest.mark.parametrize("key", ["step_response", "operating_point", "provenance", "sample_time_min"])
def test_model_that_lacks_a_key_is_refused(refused, tmp_path, model_text, key):
    model = json.loads(model_text)
    del model[key]
    (tmp_path / "m.json").write_text(json.dumps(model))
    assert f"{key} is missing" in refused("run", "--model", "m.json")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty"),
        ("[1", "is not JSON"),
        ("[]", "it should be an object"),
        ("null", "it should be an object"),
        ("\0", "is not text"),
    ],
)
def test_model_that_is_none_is_refused(refused, tmp_path, text, told):
    (tmp_path / "m.json").write_text(text)
    assert told in refused("run", "--model", "m.json")


def test_model_that_is_not_finite_is_refused(refused, tmp_path, model_text):
    model = json.loads(model_text)
    model["step_response"][0] = float("nan")
    (tmp_path / "m.json").write_text(json.dumps(model))
    assert "finite" in refused("run", "--model", "m.json")


def test_model_for_another_sample_time_is_refused(refused, tmp_path, model_text):
    (tmp_path / "m.json").write_text(json.dumps({**json.loads(model_text), "sample_time_min": 10.0}))
    assert refused("run", "--model", "m.json") == (
        "the model was identified for 10-min samples, the run uses 5 min; "
        "identify again with `glucoloop identify --sample-time 5`, or run with --sample-time 10."
    )


def test_model_that_holds_another_dead_time_is_refused(refused, tmp_path, model_text):
    model = json.loads(model_text)
    model["provenance"]["dead_time_min"] = 15.0
    (tmp_path / "m.json").write_text(json.dumps(model))
    told = refused("run", "--model", "m.json", "--dead-time", 10, "--controller", "known_dead_time=true")
    assert "run with --dead-time 15, run without known_dead_time" in told


RECORDS = {
    "": "is empty",
    "t_min,insulin_mU_min\n0,1\n": "no column 'glucose_mg_dl'",
    "t_min,insulin_mU_min,glucose_mg_dl\n0,1,90\n5,1,high\n": "'high'",
    "t_min,insulin_mU_min,glucose_mg_dl\n0,1,90\n5,1,91,7\n": "is not a CSV table: its line 3 has 4 fields",
    "t_min,insulin_mU_min,glucose_mg_dl\n5,1,90\n0,1,90\n": "later than the row before",
    "t_min,insulin_mU_min,glucose_mg_dl\n0,-1,90\n5,1,90\n": "at least 0",
    "t_min,insulin_mU_min,glucose_mg_dl\n0,1,5\n5,1,5\n": "mmol/l",
    "t_min,insulin_mU_min,glucose_mg_dl\n0,1,90\n60,1,90\n": "--max-gap",
    "t_min,insulin_mU_min,glucose_mg_dl\n": "reading: 0 of 0",
    "t_min;insulin_mU_min;glucose_mg_dl\n0;20;90\n": "separates its columns by semicolons; separate them by commas",
    "t_min;insulin_mU_min;glucose_mg_dl\n0;20,5;90,1\n": "separates its columns by semicolons",
    "t_min\tinsulin_mU_min\tglucose_mg_dl\n0\t20\t90\n": "separates its columns by tabs",
    "# from my pump\nt_min,insulin_mU_min,glucose_mg_dl\n0,20,90\n": "its line 2 has 3 fields",
    "\n".join(["t_min,insulin_mU_min,glucose_mg_dl", *(f"{5 * k},20,90" for k in range(100))]): (
        "The insulin never leaves its basal rate, so the record shows no response to it: record again while it is moved"
    ),
}


@pytest.mark.parametrize("text", RECORDS)
def test_record_is_refused(refused, tmp_path, text):
    (tmp_path / "r.csv").write_text(text)
    assert RECORDS[text] in refused("identify", "--data", "r.csv")


@pytest.mark.parametrize(
    "text",
    [f"{'a.' * 2999}a = 1", f"[{'a.' * 2999}a]", f"meals = [{{{'a.' * 2999}a = 1}}]", "a = " + "[" * 100 + "]" * 100],
)
def test_configuration_that_is_nested_deeply_is_refused(refused, tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    assert "nested too deeply" in refused("run", "--config", "a.toml")


@pytest.mark.parametrize("depth", [11, 150, 190, 199, 100_000])
@pytest.mark.parametrize(("begin", "end"), [("[", "]"), ('{"a":', "}")])
def test_model_that_is_nested_deeply_is_refused(refused, tmp_path, model_text, depth, begin, end):
    model = json.loads(model_text)
    model["provenance"]["settings"] = {"deep": "here"}
    text = json.dumps(model).replace('"here"', begin * depth + "1" + end * depth)
    (tmp_path / "m.json").write_text(text)
    told = refused("run", "--model", "m.json")
    assert "nested more than 10 times" in told or "nested too deeply" in told
