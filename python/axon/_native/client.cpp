// SPDX-License-Identifier: GPL-2.0-or-later
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

using FeedPtr = std::shared_ptr<Feed>;

/// What puts `(tag, value)` into the feed.
template <class T>
auto into(FeedPtr feed, int tag) {
    return [feed = std::move(feed), tag](const T& value) {
        feed->push([tag, value] { return py::make_tuple(tag, value); });
    };
}
auto textInto(FeedPtr feed, int tag) {
    return [feed = std::move(feed), tag](Text value) {
        feed->push([tag, value] { return py::make_tuple(tag, text(value)); });
    };
}

struct NativeClient {
    std::shared_ptr<KeepRunning> keep_running;  // outlives the client, whose heartbeats ask it
    std::shared_ptr<std::atomic<bool>> present = std::make_shared<std::atomic<bool>>(true);
    std::shared_ptr<Client> client;

    std::shared_ptr<Client> get() const {
        if (!client)
            throw RefusedError{
                {RefusalCode::NotConnected, "This connection was closed; fix: connect again", {}}};
        return client;
    }
    /// Without the GIL.
    void close() {
        if (client) client->close();
        if (keep_running) keep_running->end();
    }
};

/// The connections that are open, so that the end of the interpreter closes those that the program has left
/// open. A connection that was forgotten stays in memory until then, closed.
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

/// Waits for the end of a task or a run, or until `time` has passed; looks for KeyboardInterrupt meanwhile.
template <class Handle>
auto waitFor(const Handle& handle, std::optional<Seconds> time) {
    const auto begin = std::chrono::steady_clock::now();
    while (true) {
        auto slice = time ? std::optional(*time - (std::chrono::steady_clock::now() - begin)) : std::nullopt;
        if (slice && slice->count() < 0) slice = Seconds(0);
        bool last = slice.has_value();
        if (isMainThread() && (!slice || *slice > kSlice)) {
            slice = kSlice;
            last = false;
        }
        auto report = released([&] { return handle.wait(slice); });
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (isFinal(report.state) || last) return report;
    }
}

template <class Handle, class Report>
void bindHandle(py::class_<Handle>& bound) {
    bound.def_property_readonly("id", [](const Handle& handle) { return handle.id(); })
        .def("report", [](const Handle& handle) { return released([&] { return handle.report(); }); })
        .def("wait", &waitFor<Handle>, py::arg("time") = py::none())
        .def("on_update", [](const Handle& handle, const FeedPtr& feed,
                             int tag) { released([&] { handle.onUpdate(into<Report>(feed, tag)); }); })
        .def("pause", [](const Handle& handle) { must(released([&] { return handle.pause(); })); })
        .def("resume", [](const Handle& handle) { must(released([&] { return handle.resume(); })); })
        .def("cancel", [](const Handle& handle) { must(released([&] { return handle.cancel(); })); });
}

void bindCheckOut(py::module_& module) {
    py::class_<CheckOut> bound(module, "CheckOut");
    bound.def("entity", [](const CheckOut& held) { return released([&] { return held.entity(); }); })
        .def("services", [](const CheckOut& held) { return released([&] { return held.services(); }); })
        .def("service", [](const CheckOut& held,
                           Text name) { return must(released([&] { return held.service(name); })); })
        .def("set",
             [](const CheckOut& held, Text service, Text name, const std::vector<Value>& values, Text units) {
                 must(released([&] { return held.set(service, {name, values, units}); }));
             })
        .def("upload",
             [](const CheckOut& held, Text service, Text resource, Text file, const py::object& progress,
                GiveUp& give_up) {
                 UploadProgress told{progress, give_up, {}};
                 const auto result = released(
                     [&] { return held.upload(service, resource, file, std::ref(told), give_up.token()); });
                 if (told.thrown) throw py::error_already_set(std::move(*told.thrown));
                 must(result);
             })
        .def("run",
             [](const CheckOut& held, Text service,
                const std::vector<std::tuple<std::string, std::vector<Value>, std::string>>& arguments,
                Seconds not_after) {
                 return released([&] { return held.run(service, argumentsOf(arguments), not_after); });
             })
        .def("send_text",
             [](const CheckOut& held, Text said) { must(released([&] { return held.sendText(said); })); })
        .def("send_raw",
             [](const CheckOut& held, const py::bytes& bytes, Seconds wait) {
                 const std::string copy = bytes;
                 must(released([&] { return held.sendRaw(copy, wait); }));
             })
        .def("on_text", [](const CheckOut& held, const FeedPtr& feed,
                           int tag) { released([&] { held.onText(textInto(feed, tag)); }); })
        .def("on_raw",
             [](const CheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] {
                     held.onRaw([feed, tag](Text raw) {
                         feed->push([tag, raw] { return py::make_tuple(tag, py::bytes(raw)); });
                     });
                 });
             })
        .def("on_service_changed",
             [](const CheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] { held.onServiceChanged(into<Service>(feed, tag)); });
             })
        .def("on_lost", [](const CheckOut& held, const FeedPtr& feed,
                           int tag) { released([&] { held.onLost(into<Refusal>(feed, tag)); }); })
        .def("on_orphaned", [](const CheckOut& held, const FeedPtr& feed,
                               int tag) { released([&] { held.onOrphaned(textInto(feed, tag)); }); })
        .def("on_resumed",
             [](const CheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] {
                     held.onResumed(
                         [feed, tag] { feed->push([tag] { return py::make_tuple(tag, py::none()); }); });
                 });
             })
        .def("on_hand_over_request",
             [](const CheckOut& held, const FeedPtr& feed, int tag) {
                 released([&] { held.onHandOverRequest(into<HandOverRequest>(feed, tag)); });
             })
        .def("orphaned", [](const CheckOut& held) { return released([&] { return held.orphaned(); }); })
        .def("direct", [](const CheckOut& held) { return released([&] { return held.direct(); }); })
        .def("hand_over_request",
             [](const CheckOut& held) { return released([&] { return held.handOverRequest(); }); })
        .def("answer_hand_over",
             [](const CheckOut& held, bool accept, Text reason) {
                 must(released([&] { return held.answerHandOver(accept, reason); }));
             })
        .def("set_hand_over_policy",
             [](const CheckOut& held, const HandOverPolicy& policy) {
                 must(released([&] { return held.setHandOverPolicy(policy); }));
             })
        .def("ticket", [](const CheckOut& held) { return released([&] { return held.ticket(); }); })
        .def("reset", [](const CheckOut& held) { return must(released([&] { return held.reset(); })); })
        .def("clear", [](const CheckOut& held) { return must(released([&] { return held.clear(); })); })
        .def("release", [](const CheckOut& held) { must(released([&] { return held.release(); })); });
}

/// A call of the client that waits. `call` gets the client and owns the rest.
template <class Call>
auto waits(const NativeClient& self, GiveUp& give_up, Call call) {
    return must(interruptibly(give_up, [client = self.get(), call] { return call(*client); }));
}
template <class Call>
auto quick(const NativeClient& self, Call call) {
    const auto client = self.get();
    return released([&] { return call(*client); });
}

void bindConnection(py::module_& module) {
    py::class_<NativeClient, std::shared_ptr<NativeClient>> bound(module, "Client");
    bound
        .def("connected",
             [](const NativeClient& self) {
                 return self.client && quick(self, [](Client& c) { return c.connected(); });
             })
        .def("self", [](const NativeClient& self) { return quick(self, [](Client& c) { return c.self(); }); })
        .def("server",
             [](const NativeClient& self) { return quick(self, [](Client& c) { return c.server(); }); })
        .def("entities",
             [](const NativeClient& self, bool all) {
                 return quick(self, [&](Client& c) { return c.entities(all ? Listed::All : Listed::Ready); });
             })
        .def("find", [](const NativeClient& self,
                        Text name) { return must(quick(self, [&](Client& c) { return c.find(name); })); })
        .def("wait_for",
             [](const NativeClient& self, std::string name, Seconds time, GiveUp& give_up) {
                 return waits(self, give_up, [name, time](Client& c) { return c.waitFor(name, time); });
             })
        .def("on_entity",
             [](const NativeClient& self, const FeedPtr& feed, int tag) {
                 quick(self, [&](Client& c) {
                     c.onEntity([feed, tag](Presence presence, const Entity& entity) {
                         feed->push([tag, presence, entity] {
                             return py::make_tuple(tag, py::make_tuple(presence, entity));
                         });
                     });
                 });
             })
        .def("on_connection",
             [](const NativeClient& self, const FeedPtr& feed, int tag) {
                 quick(self, [&](Client& c) {
                     c.onConnection([feed, tag](bool connected, Text reason) {
                         feed->push([tag, connected, reason] {
                             return py::make_tuple(tag, py::make_tuple(connected, text(reason)));
                         });
                     });
                 });
             })
        .def("check_out",
             [](const NativeClient& self, std::vector<std::string> names, std::optional<Seconds> wait,
                const FeedPtr& waiting, int tag, bool ask, bool force, Text reason,
                const HandOverPolicy& hand_over, GiveUp& give_up) {
                 const auto options =
                     checkOutOptions(wait, waiting, tag, ask, force, reason, hand_over, give_up);
                 return waits(self, give_up, [names, options](Client& c) -> Result<std::vector<CheckOut>> {
                     if (names.size() != 1) return c.checkOut(names, options);
                     auto one = c.checkOut(names.front(), options);
                     if (!one) return one.refusal();
                     return std::vector{std::move(one).value()};
                 });
             })
        .def("check_out_query",
             [](const NativeClient& self, std::string query, std::optional<Seconds> wait,
                const FeedPtr& waiting, int tag, bool ask, bool force, Text reason,
                const HandOverPolicy& hand_over, GiveUp& give_up) {
                 const auto options =
                     checkOutOptions(wait, waiting, tag, ask, force, reason, hand_over, give_up);
                 return waits(self, give_up,
                              [query, options](Client& c) { return c.checkOutQuery(query, options); });
             })
        .def("resume",
             [](const NativeClient& self, std::string ticket, GiveUp& give_up) {
                 return waits(self, give_up, [ticket](Client& c) { return c.resume(ticket); });
             })
        .def("held", [](const NativeClient& self) { return quick(self, [](Client& c) { return c.held(); }); })
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
                         Text name) { must(quick(self, [&](Client& c) { return c.rearm(name); })); })
        .def("services",
             [](const NativeClient& self, Text name) {
                 return must(quick(self, [&](Client& c) { return c.services(name); }));
             })
        .def("details",
             [](const NativeClient& self, Text name) {
                 return must(quick(self, [&](Client& c) { return c.details(name); }));
             })
        .def("global_services",
             [](const NativeClient& self) {
                 return must(quick(self, [](Client& c) { return c.globalServices(); }));
             })
        .def("propose",
             [](const NativeClient& self, const GlobalService& service, const Bindings& chosen) {
                 return must(quick(self, [&](Client& c) { return c.propose(service, chosen); }));
             })
        .def("run_global",
             [](const NativeClient& self, const GlobalService& service, const Bindings& bindings, Text master,
                bool check) {
                 return must(quick(self, [&](Client& c) {
                     return check ? c.checkGlobal(service, bindings, master)
                                  : c.runGlobal(service, bindings, master);
                 }));
             })
        .def("run_history",
             [](const NativeClient& self, Texts names, int most) {
                 return must(quick(self, [&](Client& c) { return c.runHistory(names, most); }));
             })
        .def("watch",
             [](const NativeClient& self, Text name, Texts streams, const FeedPtr& feed) {
                 auto handle = must(quick(self, [&](Client& c) {
                     return c.watch(name, streams, [feed](const Sample& sample) {
                         feed->push([sample] { return toPython(sample); });
                     });
                 }));
                 return py::capsule(new std::shared_ptr<void>(std::move(handle)), [](void* watch) {
                     const auto end = [watch] { delete static_cast<std::shared_ptr<void>*>(watch); };
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
    py::class_<Task> task(module, "Task");
    bindHandle<Task, TaskReport>(task);
    py::class_<Run> run(module, "Run");
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
        if (!user.empty()) options.user = user;
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
    module.def("close_all", &closeAll, "Closes the connections that are open.");
    module.def("value_text", [](const Value& value) { return text(toText(value)); });
}

}  // namespace axon::python
