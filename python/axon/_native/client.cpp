// SPDX-License-Identifier: GPL-2.0-or-later
#include <unistd.h>

#include <atomic>
#include <iterator>

#include "bindings.hpp"
#include "feed.hpp"
#include "gil.hpp"
#include "interruptible.hpp"
#include "keep_running.hpp"
#include "sample.hpp"

namespace axon::python {
namespace {

namespace py = pybind11;
using namespace client;
using Text = const std::string&;
using Texts = const std::vector<std::string>&;

/// Becomes axon.Refused.
struct RefusedError {
    Refusal refusal;
};

template <class T>
T must(Result<T> result) {
    if (!result) throw RefusedError{result.refusal()};
    return std::move(result).value();
}
void must(const Result<void>& result) {
    if (!result) throw RefusedError{result.refusal()};
}

/// Calls `call` without the GIL.
template <class Call>
auto released(Call call) {
    const WithoutGil without;
    return call();
}

/// A child of fork() has a copy of a connection, but none of its threads, and the sockets are its parent's,
/// too. What it did with them would be done in the parent's name, or wait for ever. So every call is refused
/// there, and what belongs to the parent is left as it is, not destroyed.
void mustBe(pid_t process) {
    if (::getpid() != process)
        throw RefusedError{
            {RefusalCode::NotConnected,
             "This connection belongs to process " + std::to_string(process) +
                 ", of which this one is a fork; fix: connect in this process, or start processes "
                 "by multiprocessing.get_context(\"spawn\")",
             {}}};
}

/// A handle of the client library, and the process to which it belongs.
template <class Handle>
class OfProcess {
  public:
    explicit OfProcess(Handle handle) : handle_(new Handle(std::move(handle))) {}
    OfProcess(OfProcess&&) noexcept = default;
    OfProcess& operator=(OfProcess&&) = delete;
    ~OfProcess() {
        if (!isHere()) (void)handle_.release();
    }
    bool isHere() const { return ::getpid() == process_; }
    const Handle& get() const { return mustBe(process_), *handle_; }
    const Handle* operator->() const { return &get(); }

  private:
    const pid_t process_ = ::getpid();
    std::unique_ptr<Handle> handle_;
};
using OwnTask = OfProcess<Task>;
using OwnRun = OfProcess<Run>;
using OwnCheckOut = OfProcess<CheckOut>;
using OwnWatch = OfProcess<std::shared_ptr<void>>;

using FeedPtr = std::shared_ptr<Feed>;

/// What puts `(tag, value)` into the feed.
template <class T>
auto into(FeedPtr feed, int tag) {
    return [feed = std::move(feed), tag](const T& value) {
        feed->push([value](int to) { return py::make_tuple(to, value); }, tag);
    };
}
auto textInto(FeedPtr feed, int tag) {
    return [feed = std::move(feed), tag](Text value) {
        feed->push([value](int to) { return py::make_tuple(to, text(value)); }, tag);
    };
}
/// How much an entry takes besides the bytes in it; a guess.
constexpr std::size_t kEntry = 128;

struct NativeClient {
    const pid_t process = ::getpid();
    std::shared_ptr<KeepRunning> keep_running;  // outlives the client, whose heartbeats ask it
    std::shared_ptr<std::atomic<bool>> present = std::make_shared<std::atomic<bool>>(true);
    std::shared_ptr<Client> client;

    bool isHere() const { return ::getpid() == process; }
    std::shared_ptr<Client> get() const {
        mustBe(process);
        if (!client)
            throw RefusedError{
                {RefusalCode::NotConnected, "This connection was closed; fix: connect again", {}}};
        return client;
    }
    /// Without the GIL. Nothing in a child of fork().
    void close() {
        if (!isHere()) return;
        if (client) client->close();
        if (keep_running) keep_running->end();
    }
};

/// The connections that the program has not forgotten, so that the end of the interpreter closes them. One
/// that was forgotten has closed itself.
class Connections {
  public:
    void add(const std::shared_ptr<NativeClient>& connection) {
        const std::lock_guard lock(mutex_);
        std::erase_if(all_, [](const auto& one) { return one.expired(); });
        all_.push_back(connection);
    }
    std::vector<std::shared_ptr<NativeClient>> all() {
        const std::lock_guard lock(mutex_);
        std::vector<std::shared_ptr<NativeClient>> out;
        for (const auto& one : all_) {
            if (auto there = one.lock()) out.push_back(std::move(there));
        }
        return out;
    }

  private:
    std::mutex mutex_;
    std::vector<std::weak_ptr<NativeClient>> all_;
};

Connections& connections() {
    static Connections& the = *new Connections;
    return the;
}

void closeAll() {
    auto& left = *new std::vector(connections().all());  // kept: a thread may still be inside a call
    const WithoutGil without;
    for (const auto& one : left) one->close();
}

std::shared_ptr<NativeClient> connectTo(Options options, std::optional<Seconds> keep_running) {
    auto connection = std::shared_ptr<NativeClient>(new NativeClient, [](NativeClient* gone) {
        if (!gone->isHere()) return;
        const auto destroy = [gone] {
            gone->close();
            delete gone;
        };
        if (PyGILState_Check()) {
            released(destroy);
        } else {
            destroy();
        }
    });
    if (keep_running) {
        if (!(keep_running->count() > 0))
            throw py::value_error("keep_running: a time above 0 s was expected, or None for ever");
        connection->keep_running = std::make_shared<KeepRunning>(*keep_running);
    }
    options.keep_running = [present = connection->present, asked = connection->keep_running] {
        return *present && (!asked || asked->runs());
    };
    GiveUp never;
    auto result = interruptibly(never, [options] {
        return std::make_shared<Result<std::unique_ptr<Client>>>(Client::connect(options));
    });
    if (!*result) throw RefusedError{result->refusal()};
    connection->client = std::move(result->value());
    connections().add(connection);
    return connection;
}

CheckOutOptions checkOutOptions(std::optional<Seconds> wait, const FeedPtr& waiting, int tag, bool ask,
                                bool force, Text reason, const HandOverPolicy& hand_over,
                                const GiveUp& give_up) {
    CheckOutOptions out;
    out.wait = wait;
    if (waiting) out.on_waiting = into<Waiting>(waiting, tag);
    out.ask = ask;
    out.force = force;
    out.reason = reason;
    out.hand_over = hand_over;
    out.give_up = give_up.token();
    return out;
}

/// A progress callback in C++ for the callable of Python, which may be None. What it throws ends the upload.
struct UploadProgress {
    py::object callback;
    GiveUp& give_up;
    std::optional<py::error_already_set> thrown;

    void operator()(std::uint64_t sent, std::uint64_t total) {
        const WithGil gil;
        if (!gil || thrown) return;
        try {
            if (PyErr_CheckSignals() != 0) throw py::error_already_set();
            if (!callback.is_none()) callback(sent, total);
        } catch (py::error_already_set& error) {
            thrown.emplace(std::move(error));
            give_up.request();
        }
    }
};

std::vector<Argument> argumentsOf(
    const std::vector<std::tuple<std::string, std::vector<Value>, std::string>>& given) {
    std::vector<Argument> out;
    for (const auto& [name, values, units] : given) out.push_back({name, values, units});
    return out;
}

/// A call of the library that waits. `call` gets the client or the handle, and owns the rest. What comes when
/// nobody waits for it any more goes to `unwanted`.
template <class Call, class Unwanted = NotMissed>
auto waits(const NativeClient& self, GiveUp& give_up, Call call, Unwanted unwanted = {}) {
    return must(interruptibly(
        give_up, [client = self.get(), call] { return call(*client); }, unwanted));
}
template <class Call, class Unwanted = NotMissed>
auto waits(const NativeClient& self, Call call, Unwanted unwanted = {}) {
    GiveUp never;
    return waits(self, never, call, unwanted);
}
template <class Handle, class Call>
auto waits(const OfProcess<Handle>& handle, Call call) {
    GiveUp never;
    return must(interruptibly(never, [handle = handle.get(), call] { return call(handle); }));
}
/// A call of the client that waits for no answer of a server.
template <class Call>
auto atOnce(const NativeClient& self, Call call) {
    const auto client = self.get();
    return released([&] { return call(*client); });
}

/// Waits for the end of a task or a run, or until `time` has passed; looks for KeyboardInterrupt meanwhile.
template <class Handle>
auto waitFor(const OfProcess<Handle>& handle, std::optional<Seconds> time) {
    const auto begin = std::chrono::steady_clock::now();
    while (true) {
        auto slice = time ? std::optional(*time - (std::chrono::steady_clock::now() - begin)) : std::nullopt;
        if (slice && slice->count() < 0) slice = Seconds(0);
        bool last = slice.has_value();
        if (isMainThread() && (!slice || *slice > kSlice)) {
            slice = kSlice;
            last = false;
        }
        auto report = released([&] { return handle->wait(slice); });
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (isFinal(report.state) || last) return report;
    }
}

template <class Handle, class Report>
void bindHandle(py::class_<OfProcess<Handle>>& bound) {
    using Own = OfProcess<Handle>;
    bound.def_property_readonly("id", [](const Own& handle) { return handle->id(); })
        .def("report", [](const Own& handle) { return released([&] { return handle->report(); }); })
        .def("wait", &waitFor<Handle>, py::arg("time") = py::none())
        .def("on_update", [](const Own& handle, const FeedPtr& feed,
                             int tag) { released([&] { handle->onUpdate(into<Report>(feed, tag)); }); })
        .def("pause", [](const Own& handle) { waits(handle, [](const Handle& h) { return h.pause(); }); })
        .def("resume", [](const Own& handle) { waits(handle, [](const Handle& h) { return h.resume(); }); })
        .def("cancel", [](const Own& handle) { waits(handle, [](const Handle& h) { return h.cancel(); }); });
}

void bindCheckOut(py::module_& module) {
    py::class_<OwnCheckOut> bound(module, "CheckOut");
    bound.def("of_this_process", &OwnCheckOut::isHere)
        .def("entity", [](const OwnCheckOut& held) { return released([&] { return held->entity(); }); })
        .def("services", [](const OwnCheckOut& held) { return released([&] { return held->services(); }); })
        .def("service", [](const OwnCheckOut& held,
                           Text name) { return must(released([&] { return held->service(name); })); })
        .def("set",
             [](const OwnCheckOut& held, Text service, Text name, const std::vector<Value>& values,
                Text units) {
                 waits(held, [service, argument = Argument{name, values, units}](const CheckOut& c) {
                     return c.set(service, argument);
                 });
             })
        .def("upload",
             [](const OwnCheckOut& held, Text service, Text resource, Text file, const py::object& progress,
                GiveUp& give_up) {
                 UploadProgress told{progress, give_up, {}};
                 const auto result = released(
                     [&] { return held->upload(service, resource, file, std::ref(told), give_up.token()); });
                 if (told.thrown) throw py::error_already_set(std::move(*told.thrown));
                 must(result);
             })
        .def("run",
             [](const OwnCheckOut& held, Text service,
                const std::vector<std::tuple<std::string, std::vector<Value>, std::string>>& arguments,
                Seconds not_after) {
                 return OwnTask(
                     released([&] { return held->run(service, argumentsOf(arguments), not_after); }));
             })
        .def("send_text",
             [](const OwnCheckOut& held, Text said) {
                 waits(held, [said](const CheckOut& c) { return c.sendText(said); });
             })
        .def("send_raw",
             [](const OwnCheckOut& held, const py::bytes& bytes, Seconds wait) {
                 const std::string copy = bytes;
                 waits(held, [copy, wait](const CheckOut& c) { return c.sendRaw(copy, wait); });
             })
        .def("on_text",
             [](const OwnCheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] {
                     held->onText([feed, tag](Text said) {
                         feed->push([said](int to) { return py::make_tuple(to, text(said)); }, tag,
                                    said.size() + kEntry);
                     });
                 });
             })
        .def("on_raw",
             [](const OwnCheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] {
                     held->onRaw([feed, tag](Text raw) {
                         feed->push([raw](int to) { return py::make_tuple(to, py::bytes(raw)); }, tag,
                                    raw.size() + kEntry);
                     });
                 });
             })
        .def("on_service_changed",
             [](const OwnCheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] { held->onServiceChanged(into<Service>(feed, tag)); });
             })
        .def("on_lost", [](const OwnCheckOut& held, const FeedPtr& feed,
                           int tag) { released([&] { held->onLost(into<Refusal>(feed, tag)); }); })
        .def("on_orphaned", [](const OwnCheckOut& held, const FeedPtr& feed,
                               int tag) { released([&] { held->onOrphaned(textInto(feed, tag)); }); })
        .def("on_resumed",
             [](const OwnCheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] {
                     held->onResumed([feed, tag] {
                         feed->push([](int to) { return py::make_tuple(to, py::none()); }, tag);
                     });
                 });
             })
        .def("on_hand_over_request",
             [](const OwnCheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] { held->onHandOverRequest(into<HandOverRequest>(feed, tag)); });
             })
        .def("orphaned", [](const OwnCheckOut& held) { return released([&] { return held->orphaned(); }); })
        .def("direct", [](const OwnCheckOut& held) { return released([&] { return held->direct(); }); })
        .def("hand_over_request",
             [](const OwnCheckOut& held) { return released([&] { return held->handOverRequest(); }); })
        .def("answer_hand_over",
             [](const OwnCheckOut& held, bool accept, Text reason) {
                 waits(held,
                       [accept, reason](const CheckOut& c) { return c.answerHandOver(accept, reason); });
             })
        .def("set_hand_over_policy",
             [](const OwnCheckOut& held, const HandOverPolicy& policy) {
                 waits(held, [policy](const CheckOut& c) { return c.setHandOverPolicy(policy); });
             })
        .def("ticket", [](const OwnCheckOut& held) { return released([&] { return held->ticket(); }); })
        .def("reset",
             [](const OwnCheckOut& held) { return waits(held, [](const CheckOut& c) { return c.reset(); }); })
        .def("clear",
             [](const OwnCheckOut& held) { return waits(held, [](const CheckOut& c) { return c.clear(); }); })
        .def("release",
             [](const OwnCheckOut& held) { waits(held, [](const CheckOut& c) { return c.release(); }); });
}

/// Puts the check-outs into a list that the caller has already: KeyboardInterrupt may come before it has what
/// a call returns, and then it knows what to release.
void give(py::list granted, std::vector<CheckOut> all) {
    for (auto& one : all) granted.append(OwnCheckOut(std::move(one)));
}

/// A grant that came when nobody waited for it any more is given back.
void releaseAll(Result<std::vector<CheckOut>>& granted) {
    if (!granted) return;
    for (const auto& one : granted.value()) (void)one.release();
}

void bindConnection(py::module_& module) {
    py::class_<NativeClient, std::shared_ptr<NativeClient>> bound(module, "Client");
    bound.def("of_this_process", &NativeClient::isHere)
        .def("connected",
             [](const NativeClient& self) {
                 return self.isHere() && self.client && atOnce(self, [](Client& c) { return c.connected(); });
             })
        .def("self",
             [](const NativeClient& self) { return atOnce(self, [](Client& c) { return c.self(); }); })
        .def("server",
             [](const NativeClient& self) { return atOnce(self, [](Client& c) { return c.server(); }); })
        .def("entities",
             [](const NativeClient& self, bool all) {
                 return atOnce(self,
                               [&](Client& c) { return c.entities(all ? Listed::All : Listed::Ready); });
             })
        .def("find", [](const NativeClient& self,
                        Text name) { return must(atOnce(self, [&](Client& c) { return c.find(name); })); })
        .def("wait_for",
             [](const NativeClient& self, std::string name, Seconds time, GiveUp& give_up) {
                 return waits(self, give_up, [name, time](Client& c) { return c.waitFor(name, time); });
             })
        .def("on_entity",
             [](const NativeClient& self, const FeedPtr& feed, int tag) {
                 atOnce(self, [&](Client& c) {
                     c.onEntity([feed, tag](Presence presence, const Entity& entity) {
                         feed->push(
                             [presence, entity](int to) {
                                 return py::make_tuple(to, py::make_tuple(presence, entity));
                             },
                             tag);
                     });
                 });
             })
        .def("on_connection",
             [](const NativeClient& self, const FeedPtr& feed, int tag) {
                 atOnce(self, [&](Client& c) {
                     c.onConnection([feed, tag](bool connected, Text reason) {
                         feed->push(
                             [connected, reason](int to) {
                                 return py::make_tuple(to, py::make_tuple(connected, text(reason)));
                             },
                             tag);
                     });
                 });
             })
        .def("check_out",
             [](const NativeClient& self, std::vector<std::string> names, std::optional<Seconds> wait,
                const FeedPtr& waiting, int tag, bool ask, bool force, Text reason,
                const HandOverPolicy& hand_over, GiveUp& give_up, const py::list& granted) {
                 const auto options =
                     checkOutOptions(wait, waiting, tag, ask, force, reason, hand_over, give_up);
                 give(granted, waits(
                                   self, give_up,
                                   [names, options](Client& c) -> Result<std::vector<CheckOut>> {
                                       if (names.size() != 1) return c.checkOut(names, options);
                                       auto one = c.checkOut(names.front(), options);
                                       if (!one) return one.refusal();
                                       return std::vector{std::move(one).value()};
                                   },
                                   releaseAll));
             })
        .def("check_out_query",
             [](const NativeClient& self, std::string query, std::optional<Seconds> wait,
                const FeedPtr& waiting, int tag, bool ask, bool force, Text reason,
                const HandOverPolicy& hand_over, GiveUp& give_up, const py::list& granted) {
                 const auto options =
                     checkOutOptions(wait, waiting, tag, ask, force, reason, hand_over, give_up);
                 give(granted, waits(
                                   self, give_up,
                                   [query, options](Client& c) { return c.checkOutQuery(query, options); },
                                   releaseAll));
             })
        .def("resume",
             [](const NativeClient& self, std::string ticket, GiveUp& give_up, const py::list& granted) {
                 give(granted, waits(
                                   self, give_up,
                                   [ticket](Client& c) -> Result<std::vector<CheckOut>> {
                                       auto one = c.resume(ticket);
                                       if (!one) return one.refusal();
                                       return std::vector{std::move(one).value()};
                                   },
                                   releaseAll));
             })
        .def("held",
             [](const NativeClient& self) {
                 py::list out;
                 give(out, atOnce(self, [](Client& c) { return c.held(); }));
                 return out;
             })
        .def("stop",
             [](const NativeClient& self, std::vector<std::string> names, Seconds deadline,
                Seconds standstill, GiveUp& give_up) {
                 return waits(self, give_up, [names, deadline, standstill](Client& c) {
                     return c.stop(names, deadline, standstill);
                 });
             })
        .def("drill",
             [](const NativeClient& self, std::vector<std::string> names, int count, Seconds period,
                GiveUp& give_up) {
                 return waits(self, give_up, [names, count, period, token = give_up.token()](Client& c) {
                     return c.drill(names, count, period, token);
                 });
             })
        .def("rearm", [](const NativeClient& self,
                         Text name) { waits(self, [name](Client& c) { return c.rearm(name); }); })
        .def("services",
             [](const NativeClient& self, Text name) {
                 return waits(self, [name](Client& c) { return c.services(name); });
             })
        .def("details", [](const NativeClient& self,
                           Text name) { return waits(self, [name](Client& c) { return c.details(name); }); })
        .def("global_services",
             [](const NativeClient& self) {
                 return waits(self, [](Client& c) { return c.globalServices(); });
             })
        .def("propose",
             [](const NativeClient& self, const GlobalService& service, const Bindings& chosen) {
                 return waits(self, [service, chosen](Client& c) { return c.propose(service, chosen); });
             })
        .def("run_global",
             [](const NativeClient& self, const GlobalService& service, const Bindings& bindings, Text master,
                bool check) {
                 return OwnRun(waits(
                     self,
                     [service, bindings, master, check](Client& c) {
                         return check ? c.checkGlobal(service, bindings, master)
                                      : c.runGlobal(service, bindings, master);
                     },
                     [](Result<Run>& run) {
                         if (run) (void)run->cancel();
                     }));
             })
        .def("run_history",
             [](const NativeClient& self, Texts names, int most) {
                 return waits(self, [names, most](Client& c) { return c.runHistory(names, most); });
             })
        .def("watch",
             [](const NativeClient& self, Text name, Texts streams, const FeedPtr& feed) {
                 auto handle = must(atOnce(self, [&](Client& c) {
                     return c.watch(name, streams, [feed](const Sample& sample) {
                         const auto size = sample.raw.size() + kEntry;
                         feed->push([copy = std::make_shared<Sample>(sample)](
                                        int) { return toPython(std::move(*copy)); },  // it is taken once
                                    0, size);
                     });
                 }));
                 return py::capsule(new OwnWatch(std::move(handle)), [](void* watch) {
                     const auto end = [watch] { delete static_cast<OwnWatch*>(watch); };
                     released(end);
                 });
             })
        .def("present", [](const NativeClient& self) { return self.present->load(); })
        .def("set_present", [](const NativeClient& self, bool present) { *self.present = present; })
        .def("close", [](NativeClient& self) { released([&] { self.close(); }); });
}

void translate(std::exception_ptr thrown) {
    try {
        std::rethrow_exception(thrown);
    } catch (const RefusedError& error) {
        const auto type = py::module_::import("axon.errors").attr("Refused");
        const auto made = type(error.refusal.code, text(error.refusal.message), text(error.refusal.holder));
        PyErr_SetObject(type.ptr(), made.ptr());
    }
}

}  // namespace

void bindClient(py::module_& module) {
    py::register_exception_translator(&translate);
    py::class_<GiveUp, std::shared_ptr<GiveUp>>(module, "GiveUp", "Asks a call that waits to give up.")
        .def(py::init<>())
        .def("request", &GiveUp::request);
    py::class_<OwnTask> task(module, "Task");
    bindHandle<Task, TaskReport>(task);
    py::class_<OwnRun> run(module, "Run");
    bindHandle<Run, RunReport>(run);
    bindCheckOut(module);
    bindConnection(module);
    module.def("connect", [](Text server, Text config, Text user, Text password,
                             const std::map<std::string, std::string>& properties, Text name, Seconds timeout,
                             bool reconnect, bool resume, bool await_entities, bool direct, int direct_paths,
                             std::optional<Seconds> keep_running) {
        Options options;
        if (!config.empty()) options = must(released([&] { return readConfiguration(config, options); }));
        if (!server.empty()) options.server = server;
        if (!user.empty() && user != options.user) {
            options.user = user;
            options.password.clear();  // a password goes with its user
        }
        if (!password.empty()) options.password = password;
        for (const auto& [key, value] : properties) options.properties[key] = value;
        options.display_name = name;
        options.timeout = timeout;
        options.reconnect = reconnect;
        options.resume = resume;
        options.await_entities = await_entities;
        options.direct = direct;
        options.direct_paths = direct_paths;
        return connectTo(std::move(options), keep_running);
    });
    module.def("check_process", &mustBe, py::arg("process"), "Refused in a child of fork() of this process.");
    module.def("close_all", &closeAll, "Closes the connections that are open.");
    module.def("value_text", [](const Value& value) { return text(toText(value)); });
}

}  // namespace axon::python
